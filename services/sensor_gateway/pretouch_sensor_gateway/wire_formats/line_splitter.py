"""Splits bytes, in pieces of any size, into lines of text."""

from __future__ import annotations

import re

from pretouch_sensor_gateway.wire_formats.parser import Refusal

MAX_LINE = 512
"""Longest line without its end, bytes: 64 modules of seven characters each. It bounds the memory that a line without an
end takes."""
BLANK = b" \t"
"""A line of these alone is ignored."""

_PRINTABLE = re.compile(rb"[\t\x20-\x7e]*")


class LineSplitter:
    r"""Splits at "\n", "\r" and "\r\n".

    What comes before the first line end is refused: its beginning may be missing, and "34 120" may have been
    "134 120". So are lines that are too long, or hold anything but printable ASCII and tabs.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._oversize = False
        self._synchronised = False

    def feed(self, data: bytes) -> list[str | Refusal]:
        """The lines that `data` ends, without blank ones and line ends, or why each is refused; never raises."""
        *ended, rest = data.replace(b"\r", b"\n").split(b"\n")
        lines = []
        for piece in ended:
            self._append(piece)
            line = self._close()
            if line is not None:
                lines.append(line)
        self._append(rest)
        return lines

    def restart(self) -> None:
        """Forgets a half-received line: the port was closed."""
        self._buffer.clear()
        self._oversize = self._synchronised = False

    def _append(self, piece: bytes) -> None:
        if len(self._buffer) + len(piece) > MAX_LINE:
            self._oversize = True
            self._buffer.clear()
        if not self._oversize:
            self._buffer += piece

    def _close(self) -> str | Refusal | None:
        line, oversize, whole = bytes(self._buffer).strip(BLANK), self._oversize, self._synchronised
        self.restart()
        self._synchronised = True
        if oversize:
            return Refusal.OVERSIZE
        if not line:
            return None
        if not _PRINTABLE.fullmatch(line):
            return Refusal.ENCODING
        return line.decode("ascii") if whole else Refusal.FIELDS
