"""The binary format: a frame is a message and its CRC-16, COBS-encoded, ended by a zero byte.

COBS (Cheshire and Baker, 1999) removes every zero from the data, so that a zero always ends a frame and a receiver that
joins in the middle is synchronised at the next one. docs/reference/wire-formats.md
describes the format for the author of a firmware.
"""

from __future__ import annotations

import struct
from collections import Counter

from cobs import cobs
from fastcrc import crc16

from pretouch_sensor_gateway.wire_formats.messages import (
    COUNTER_MODULUS,
    BadLength,
    Identify,
    Message,
    Ping,
    UnknownKind,
    UnknownVersion,
    pack,
    unpack,
)
from pretouch_sensor_gateway.wire_formats.parser import DeviceMessage, Refusal

MAX_FRAME = 208
"""Longest encoded frame without its zero, bytes: 64 modules.

A line that never sends a zero (a wrong baud rate, a boot loader that prints, a hostile device) would otherwise fill the
memory. It is also below the 255 bytes from which COBS needs blocks that end without a zero.
"""
END = b"\0"
INTERRUPT = 0x03
"""Ctrl-C, which stops the program of a board that runs MicroPython or CircuitPython: nothing sent holds it."""
_CRC = struct.Struct("<H")


def encode(message: Message) -> bytes:
    """The frame of `message`, with the zero that ends it."""
    body = pack(message)
    encoded: bytes = cobs.encode(body + _CRC.pack(crc16.ibm_3740(body)))
    return encoded + END


class FrameDecoder:
    """Decodes bytes, in pieces of any size, into messages of either direction.

    Attributes:
        refused: frames refused so far, by reason.
    """

    def __init__(self) -> None:
        self.refused: Counter[Refusal] = Counter()
        self._buffer = bytearray()
        self._oversize = False

    def feed(self, data: bytes) -> list[Message]:
        """The messages that `data` completes, in their order; never raises."""
        *ended, rest = data.split(END)
        messages = []
        for piece in ended:
            self._append(piece)
            message = self._close()
            if message is not None:
                messages.append(message)
        self._append(rest)
        return messages

    def restart(self) -> None:
        """Forgets a half-received frame: the port was closed."""
        self._buffer.clear()
        self._oversize = False

    def _append(self, piece: bytes) -> None:
        if len(self._buffer) + len(piece) > MAX_FRAME:
            self._oversize = True
            self._buffer.clear()
        if not self._oversize:
            self._buffer += piece

    def _close(self) -> Message | None:
        frame, oversize = bytes(self._buffer), self._oversize
        self.restart()
        if oversize:
            self.refused[Refusal.OVERSIZE] += 1
            return None
        if not frame:
            return None  # consecutive zeros are padding
        outcome = _decode(frame)
        if isinstance(outcome, Refusal):
            self.refused[outcome] += 1
            return None
        return outcome


class BinaryParser:
    """Parses what a device sends in the binary format (a `Parser`)."""

    name = "binary"
    unit = "mm"
    problem = ""
    two_way = True
    tick_modulus = COUNTER_MODULUS

    def __init__(self) -> None:
        self._decoder = FrameDecoder()

    @property
    def refused(self) -> Counter[Refusal]:
        return self._decoder.refused

    def feed(self, data: bytes) -> list[DeviceMessage]:
        received: list[DeviceMessage] = []
        for message in self._decoder.feed(data):
            if isinstance(message, Ping | Identify):
                self.refused[Refusal.KIND] += 1  # sent by the gateway itself: the port echoes
            else:
                received.append(message)
        return received

    def restart(self) -> None:
        self._decoder.restart()


def _decode(frame: bytes) -> Message | Refusal:
    try:
        decoded = cobs.decode(frame)
    except cobs.DecodeError:
        return Refusal.ENCODING
    body, checksum = decoded[: -_CRC.size], decoded[-_CRC.size :]
    if not body:
        return Refusal.LENGTH
    if checksum != _CRC.pack(crc16.ibm_3740(body)):
        return Refusal.CHECKSUM
    try:
        return unpack(body)
    except UnknownVersion:
        return Refusal.VERSION
    except UnknownKind:
        return Refusal.KIND
    except BadLength:
        return Refusal.LENGTH
