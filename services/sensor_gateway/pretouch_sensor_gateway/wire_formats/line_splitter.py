"""Splits bytes, in pieces of any size, into lines of text."""

from __future__ import annotations

import re

from pretouch_sensor_gateway.wire_formats.parser import Refusal

MAX_LINE = 1024
"""Longest line without its end, bytes: 64 modules with range and status. It bounds the memory that a line without an
end takes."""
BLANK = b" \t"
"""A line of these alone is blank."""

_COLOUR = re.compile(rb"\x1b\[[0-9;]*m")
"""Terminal colours, which ESP-IDF and ESPHome print around each line."""
_PRINTABLE = re.compile(rb"[\t\x20-\x7e]*")


class LineSplitter:
    r"""Splits at "\n", "\r" and "\r\n".

    What comes before the first line end is refused: its beginning may be missing, and "34 120" may have been
    "134 120". So are lines that are too long, or hold anything but printable ASCII, tabs and terminal colours.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._oversize = False
        self._synchronised = False
        self._after_return = False

    def feed(self, data: bytes) -> list[str | Refusal]:
        """The lines that `data` ends, "" for a blank one, or why each is refused; never raises."""
        if self._after_return and data[:1] == b"\n":
            data = data[1:]  # the second half of "\r\n"
        if data:
            self._after_return = data[-1:] == b"\r"
        *ended, rest = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")
        lines = []
        for piece in ended:
            self._append(piece)
            lines.append(self._close())
        self._append(rest)
        return lines

    def restart(self) -> None:
        """Forgets a half-received line: the port was closed."""
        self._buffer.clear()
        self._oversize = self._synchronised = self._after_return = False

    def _append(self, piece: bytes) -> None:
        if len(self._buffer) + len(piece) > MAX_LINE:
            self._oversize = True
            self._buffer.clear()
        if not self._oversize:
            self._buffer += piece

    def _close(self) -> str | Refusal:
        line, oversize, whole = bytes(self._buffer), self._oversize, self._synchronised
        self._buffer.clear()
        self._oversize, self._synchronised = False, True
        if oversize:
            return Refusal.OVERSIZE
        if not line.strip(BLANK):
            return ""
        if b"\x1b" in line:
            line = _COLOUR.sub(b"", line) or line
        if not _PRINTABLE.fullmatch(line):
            return Refusal.ENCODING
        return line.decode("ascii") if whole else Refusal.FIELDS
