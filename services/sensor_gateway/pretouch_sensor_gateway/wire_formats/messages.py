"""The messages of the binary format, in both directions, and how each is packed.

All numbers are little-endian. Every message starts with the same twelve bytes: version, kind, boot, sequence, time.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from enum import IntEnum

from pretouch_sensor_gateway.wire_formats.parser import Identity, Measurement, PingReply

VERSION = 1
RANGE_UNIT = 1e-4
"""Metres of one step of a range on the wire: fine compared to the 1.5 mm noise of the best sensor; 6.5 m at most."""
MAX_MODULES = 64
"""With more, a message would exceed the 254 bytes in which COBS needs no long block (see binary.py)."""
MAX_FIRMWARE = 32
"""Bytes of the firmware's name, ASCII."""
COUNTER_MODULUS = 2**32
"""Sequence numbers and device times are unsigned 32-bit integers that wrap."""

_NO_RANGE = 0xFFFF
_HEADER = struct.Struct("<BBHII")
_FILLED_BOOT, _FILLED_TIME = 0xFFFF, 0xFFFFFFFF
"""On the way to the device, which ignores both: of zeros COBS would make bytes of 0x03 (see `binary.INTERRUPT`)."""
_COUNT = struct.Struct("<B")
_MODULE = struct.Struct("<HB")
_IDENTITY = struct.Struct("<8sBI")


class Kind(IntEnum):
    """Second byte of a message. The highest bit is set on the way to the device."""

    RANGES = 0x01
    PING_REPLY = 0x02
    IDENTITY = 0x03
    PING = 0x81
    IDENTIFY = 0x83


@dataclass(frozen=True)
class Ping:
    """The host asks for the device's time; `sequence` comes back in the reply."""

    sequence: int


@dataclass(frozen=True)
class Identify:
    """The host asks the device who it is."""


Message = Measurement | PingReply | Identity | Ping | Identify


class UnknownVersion(ValueError):
    """The message is of another version of the format."""


class BadLength(ValueError):
    """The message's length does not fit its kind and contents."""


class UnknownKind(ValueError):
    """The message is of a kind that this version does not have."""


def pack(message: Message) -> bytes:
    """The bytes of `message`, without checksum and framing.

    Ranges are rounded to `RANGE_UNIT` and clipped to 16 bits; 1 to `MAX_MODULES` modules.

    Raises:
        ValueError: a measurement without boot, sequence or time, or with another number of modules.
    """
    match message:
        case Ping(sequence):
            return _HEADER.pack(VERSION, Kind.PING, _FILLED_BOOT, sequence, _FILLED_TIME)
        case Identify():
            return _HEADER.pack(VERSION, Kind.IDENTIFY, _FILLED_BOOT, 0, _FILLED_TIME)
        case PingReply(boot, sequence, micros):
            return _HEADER.pack(VERSION, Kind.PING_REPLY, boot, sequence, micros)
        case Identity():
            return _pack_identity(message)
        case Measurement():
            return _pack_measurement(message)


def unpack(data: bytes) -> Message:
    """The message that `pack` packed.

    Raises:
        BadLength, UnknownVersion, UnknownKind: the message is not valid.
    """
    if len(data) < _HEADER.size:
        raise BadLength
    version, kind, boot, sequence, micros = _HEADER.unpack_from(data)
    if version != VERSION:
        raise UnknownVersion
    rest = data[_HEADER.size :]
    if kind == Kind.RANGES:
        return _unpack_measurement(rest, boot, sequence, micros)
    if kind == Kind.IDENTITY:
        return _unpack_identity(rest, boot)
    if kind not in (Kind.PING, Kind.PING_REPLY, Kind.IDENTIFY):
        raise UnknownKind
    if rest:
        raise BadLength
    if kind == Kind.PING_REPLY:
        return PingReply(boot, sequence, micros)
    return Ping(sequence) if kind == Kind.PING else Identify()


def _pack_measurement(message: Measurement) -> bytes:
    if message.boot is None or message.sequence is None or message.micros is None:
        raise ValueError("the binary format has boot, sequence and time in every measurement")
    if not 1 <= len(message.ranges) <= MAX_MODULES:
        raise ValueError(f"a message holds 1 to {MAX_MODULES} modules, not {len(message.ranges)}")
    modules = b"".join(
        _MODULE.pack(_steps(metres), status) for metres, status in zip(message.ranges, message.status, strict=True)
    )
    header = _HEADER.pack(VERSION, Kind.RANGES, message.boot, message.sequence, message.micros)
    return header + _COUNT.pack(len(message.ranges)) + modules


def _unpack_measurement(rest: bytes, boot: int, sequence: int, micros: int) -> Measurement:
    if not rest or not 1 <= rest[0] <= MAX_MODULES or len(rest) != _COUNT.size + rest[0] * _MODULE.size:
        raise BadLength
    steps, status = zip(*_MODULE.iter_unpack(rest[_COUNT.size :]), strict=True)
    metres = [math.nan if step == _NO_RANGE else step * RANGE_UNIT for step in steps]
    return Measurement(boot, sequence, micros, tuple(metres), status)


def _pack_identity(message: Identity) -> bytes:
    firmware = message.firmware.encode("ascii", "replace")[:MAX_FIRMWARE]
    serial = bytes.fromhex(message.serial or "00" * 8)
    header = _HEADER.pack(VERSION, Kind.IDENTITY, message.boot, 0, 0)
    return header + _IDENTITY.pack(serial, message.modules, round(message.period * 1e6)) + firmware


def _unpack_identity(rest: bytes, boot: int) -> Identity:
    if not _IDENTITY.size <= len(rest) <= _IDENTITY.size + MAX_FIRMWARE:
        raise BadLength
    serial, modules, period = _IDENTITY.unpack_from(rest)
    firmware = "".join(chr(byte) if 0x20 <= byte < 0x7F else "?" for byte in rest[_IDENTITY.size :])
    return Identity(boot, serial.hex() if any(serial) else "", modules, period * 1e-6, firmware)


def _steps(metres: float) -> int:
    if math.isnan(metres):
        return _NO_RANGE
    return round(min(max(metres / RANGE_UNIT, 0), _NO_RANGE - 1))
