"""Detects a device's wire format from what it sends, and parses it; creates parsers by name."""

from __future__ import annotations

import re
from collections import Counter

from pretouch.errors import InvalidInput
from pretouch_sensor_gateway.wire_formats.format_detector import FormatDetector
from pretouch_sensor_gateway.wire_formats.line_splitter import BLANK
from pretouch_sensor_gateway.wire_formats.parser import DeviceMessage, Parser, Refusal
from pretouch_sensor_gateway.wire_formats.registry import PARSERS

AUTO = "auto"
"""The name that asks for detection."""
FORMATS = (AUTO, *PARSERS)
"""The names of all formats, `AUTO` first."""
MAX_UNDETECTED = 8192
"""Bytes that are kept while the format is not certain. When there are more, they are discarded and detection
restarts."""

_END = re.compile(rb"[\0\r\n]")
"""What ends a frame or a line."""


def create_parser(name: str) -> Parser:
    """Creates a parser of the format `name`, one of `FORMATS`.

    Raises:
        InvalidInput: there is no such format.
    """
    if name == AUTO:
        return AutoDetectingParser()
    if name not in PARSERS:
        raise InvalidInput(f"There is no wire format {name!r}.", f"Choose one of {', '.join(FORMATS)}.")
    return PARSERS[name]()


class AutoDetectingParser:
    """Detects the format of a connection from its first bytes (a `Parser`).

    Nothing is sent to a device before its format is known: a sketch that prints text may read what it gets as commands.
    Once the format is known, everything received since the connection began, or since bytes were last discarded, is
    parsed at once. Discarded bytes count as refused, once for each piece between zeros and line ends. After an outage
    detection restarts: another device may be on the port.

    Attributes:
        name: of the detected format, "" before.
    """

    def __init__(self) -> None:
        self.refused: Counter[Refusal] = Counter()
        self._parser: Parser | None = None
        self._detector = FormatDetector()
        self._held = bytearray()

    @property
    def name(self) -> str:
        return self._parser.name if self._parser else ""

    @property
    def two_way(self) -> bool:
        return self._parser is not None and self._parser.two_way

    @property
    def tick_modulus(self) -> int | None:
        return self._parser.tick_modulus if self._parser else None

    def feed(self, data: bytes) -> list[DeviceMessage]:
        start = 0
        while self._parser is None and start < len(data):
            end = _END.search(data, start)
            piece = data[start : end.end() if end else len(data)][: MAX_UNDETECTED - len(self._held)]
            start += len(piece)
            self._detect(piece)
        if self._parser is None:
            return []
        received = self._parser.feed(bytes(self._held) + data[start:])
        self._held.clear()
        if self._parser.refused:
            self.refused.update(self._parser.refused)
            self._parser.refused.clear()
        return received

    def restart(self) -> None:
        self._discard()
        self._parser = None

    def _detect(self, piece: bytes) -> None:
        self._held += piece
        name = self._detector.add(piece)
        if name is not None:
            self._parser = PARSERS[name]()
        elif len(self._held) == MAX_UNDETECTED:
            self._discard()

    def _discard(self) -> None:
        pieces = _END.split(bytes(self._held))
        self.refused[Refusal.ENCODING] += sum(bool(piece.strip(BLANK)) for piece in pieces)
        self._held.clear()
        self._detector = FormatDetector()
