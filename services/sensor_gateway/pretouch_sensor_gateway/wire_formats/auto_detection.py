"""A format for devices whose format nobody has told: it listens until it is certain, then passes everything on."""

from __future__ import annotations

import re
from collections import Counter

from pretouch.errors import InvalidInput
from pretouch_sensor_gateway.wire_formats.format_detector import FormatDetector
from pretouch_sensor_gateway.wire_formats.line_splitter import BLANK
from pretouch_sensor_gateway.wire_formats.parser import DeviceMessage, Parser, Refusal
from pretouch_sensor_gateway.wire_formats.registry import PARSERS

AUTO = "auto"
"""Recognises the format from what the device sends."""
FORMATS = (AUTO, *PARSERS)
"""The names of all formats, `AUTO` first."""
ROUND = 8192
"""Bytes that are kept while the format is not certain. When they are full, they are given up and all begins anew."""

_END = re.compile(rb"[\0\r\n]")
"""What ends a frame or a line."""


def create_parser(name: str) -> Parser:
    """A fresh reader of the format `name`, one of `FORMATS`.

    Raises:
        InvalidInput: there is no such format.
    """
    if name == AUTO:
        return AutoDetectingParser()
    if name not in PARSERS:
        raise InvalidInput(f"There is no wire format {name!r}.", f"Choose one of {', '.join(FORMATS)}.")
    return PARSERS[name]()


class AutoDetectingParser:
    """Recognises the format of a connection from its first bytes (a `Parser`).

    Nothing is sent to a device before its format is known: a sketch that prints text may read what it gets as commands.
    Once the format is known, all that was received since the connection began, or since bytes were last given up, comes
    out at once. Bytes given up are counted as refused, by the pieces between their zeros and line ends. After a cut all
    begins anew: another device may sit on the line.

    Attributes:
        name: of the recognised format, "" before.
    """

    def __init__(self) -> None:
        self.refused: Counter[Refusal] = Counter()
        self._chosen: Parser | None = None
        self._detector = FormatDetector()
        self._held = bytearray()

    @property
    def name(self) -> str:
        return self._chosen.name if self._chosen else ""

    @property
    def two_way(self) -> bool:
        return self._chosen is not None and self._chosen.two_way

    @property
    def tick_modulus(self) -> int | None:
        return self._chosen.tick_modulus if self._chosen else None

    def feed(self, data: bytes) -> list[DeviceMessage]:
        start = 0
        while self._chosen is None and start < len(data):
            end = _END.search(data, start)
            piece = data[start : end.end() if end else len(data)][: ROUND - len(self._held)]
            start += len(piece)
            self._hear(piece)
        if self._chosen is None:
            return []
        received = self._chosen.feed(bytes(self._held) + data[start:])
        self._held.clear()
        if self._chosen.refused:
            self.refused.update(self._chosen.refused)
            self._chosen.refused.clear()
        return received

    def restart(self) -> None:
        self._give_up()
        self._chosen = None

    def _hear(self, piece: bytes) -> None:
        self._held += piece
        name = self._detector.add(piece)
        if name is not None:
            self._chosen = PARSERS[name]()
        elif len(self._held) == ROUND:
            self._give_up()

    def _give_up(self) -> None:
        pieces = _END.split(bytes(self._held))
        self.refused[Refusal.ENCODING] += sum(bool(piece.strip(BLANK)) for piece in pieces)
        self._held.clear()
        self._detector = FormatDetector()
