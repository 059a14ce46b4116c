"""What the gateway and a finger say to each other, and how each message is packed.

All numbers are little-endian. Every message starts with the same ten bytes: version, kind, sequence, device time.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from enum import IntEnum

VERSION = 1
RANGE_UNIT = 1e-4
"""Metres of one step of a range on the wire: fine beside the 1.5 mm of the best sensor, 6.5 m at most."""
MAX_MODULES = 64
"""With more, a message would exceed the 254 bytes in which COBS needs no long block (see framing.py)."""
COUNTER_MODULUS = 2**32
"""Sequence numbers and device times are unsigned 32-bit integers that wrap."""

_NO_RANGE = 0xFFFF
_HEADER = struct.Struct("<BBII")
_COUNT = struct.Struct("<B")
_MODULE = struct.Struct("<HB")


class Kind(IntEnum):
    """Second byte of a message. The highest bit is set on the way to the device."""

    RANGES = 0x01
    PING_REPLY = 0x02
    PING = 0x81


@dataclass(frozen=True)
class Ranges:
    """One measurement of every module.

    Attributes:
        sequence: counts measurements from the device's start; 32 bits, wraps.
        micros: device clock at the measurement, microseconds; 32 bits, wraps.
        ranges: m along the beam of each module, NaN where it gave none.
        status: each module's own status code, 0 is good.
    """

    sequence: int
    micros: int
    ranges: tuple[float, ...]
    status: tuple[int, ...]


@dataclass(frozen=True)
class Ping:
    """The host asks for the device's time; `sequence` comes back in the reply."""

    sequence: int


@dataclass(frozen=True)
class PingReply:
    """The answer to the ping of that `sequence`: `micros` is the device clock when it is sent."""

    sequence: int
    micros: int


Message = Ranges | Ping | PingReply


class UnknownVersion(ValueError):
    """The message is of another version of the format."""


class BadLength(ValueError):
    """The message's length does not fit its kind and number of modules."""


class UnknownKind(ValueError):
    """The message is of a kind that this version does not have."""


def pack(message: Message) -> bytes:
    """The bytes of `message`, without checksum and framing.

    Ranges are rounded to `RANGE_UNIT` and held within what 16 bits can say; 1 to `MAX_MODULES` modules.
    """
    if isinstance(message, Ping):
        return _HEADER.pack(VERSION, Kind.PING, message.sequence, 0)
    if isinstance(message, PingReply):
        return _HEADER.pack(VERSION, Kind.PING_REPLY, message.sequence, message.micros)
    if not 1 <= len(message.ranges) <= MAX_MODULES:
        raise BadLength(f"a message holds 1 to {MAX_MODULES} modules, not {len(message.ranges)}")
    modules = b"".join(
        _MODULE.pack(_steps(metres), status) for metres, status in zip(message.ranges, message.status, strict=True)
    )
    header = _HEADER.pack(VERSION, Kind.RANGES, message.sequence, message.micros)
    return header + _COUNT.pack(len(message.ranges)) + modules


def unpack(data: bytes) -> Message:
    """The message that `pack` packed.

    Raises:
        BadLength, UnknownVersion, UnknownKind: what the names say.
    """
    if len(data) < _HEADER.size:
        raise BadLength
    version, kind, sequence, micros = _HEADER.unpack_from(data)
    if version != VERSION:
        raise UnknownVersion
    if kind == Kind.RANGES:
        return _unpack_ranges(data, sequence, micros)
    if kind not in (Kind.PING, Kind.PING_REPLY):
        raise UnknownKind
    if len(data) != _HEADER.size:
        raise BadLength
    return Ping(sequence) if kind == Kind.PING else PingReply(sequence, micros)


def _unpack_ranges(data: bytes, sequence: int, micros: int) -> Ranges:
    start = _HEADER.size + _COUNT.size
    if len(data) < start:
        raise BadLength
    count = data[_HEADER.size]
    if not 1 <= count <= MAX_MODULES or len(data) != start + count * _MODULE.size:
        raise BadLength
    steps, status = zip(*_MODULE.iter_unpack(data[start:]), strict=True)
    return Ranges(sequence, micros, tuple(_metres(step) for step in steps), status)


def _steps(metres: float) -> int:
    if math.isnan(metres):
        return _NO_RANGE
    return round(min(max(metres / RANGE_UNIT, 0), _NO_RANGE - 1))


def _metres(steps: int) -> float:
    return math.nan if steps == _NO_RANGE else steps * RANGE_UNIT
