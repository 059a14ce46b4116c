"""The bytes that a device sent last, for people and for the diagnosis of what cannot be read."""

from __future__ import annotations

import re

from pretouch_sensor_gateway.wire_formats.quoting import quote, quote_bytes

_KEPT = 6000
"""Bytes that are kept: a dozen lines of 64 ranges, or two hundred of one."""
_LINES = 12
"""Lines that are shown."""
_PRINTABLE = re.compile(rb"[\t\x1b\x20-\x7e]*")


class RecentInput:
    """Keeps the last bytes of a connection.

    Attributes:
        received_at: host time at which the last came, s.
    """

    def __init__(self) -> None:
        self.received_at = -float("inf")
        self._bytes = bytearray()

    def add(self, data: bytes, at: float) -> None:
        self.received_at = at
        self._bytes += data
        if len(self._bytes) > 2 * _KEPT:
            del self._bytes[:-_KEPT]

    def clear(self) -> None:
        """Forgets all: the port was opened anew."""
        self._bytes.clear()

    def last(self) -> bytes:
        """The last bytes, oldest first."""
        return bytes(self._bytes[-_KEPT:])

    def lines(self) -> list[str]:
        """The last lines, oldest first, each in quotes and escaped; what is no text in hexadecimal."""
        pieces = [piece for piece in re.split(rb"[\r\n]+", self.last()) if piece][-_LINES:]
        return [
            quote(piece.decode("ascii")) if _PRINTABLE.fullmatch(piece) else quote_bytes(piece[-16:])
            for piece in pieces
        ]
