"""Detects a device's wire format from what it sends, and parses it.

A format is chosen only when it is certain, and never by a guess of the unit: one whole frame of the gateway's own
binary format, four of another maker's, two lines that only one known sketch prints, or several that tell their unit.
Bare numbers are never read: `diagnosis` asks the user for the unit.
"""

from __future__ import annotations

import re
from collections import Counter, deque

from pretouch_sensor_gateway.wire_formats.benewake import BenewakeFrame
from pretouch_sensor_gateway.wire_formats.binary import BinaryParser
from pretouch_sensor_gateway.wire_formats.fixed_frames import FixedFrameParser
from pretouch_sensor_gateway.wire_formats.inference import infer
from pretouch_sensor_gateway.wire_formats.line_format import LineFormat
from pretouch_sensor_gateway.wire_formats.line_splitter import BLANK, LineSplitter
from pretouch_sensor_gateway.wire_formats.parser import DeviceMessage, Parser, Refusal
from pretouch_sensor_gateway.wire_formats.presets import TELLING
from pretouch_sensor_gateway.wire_formats.teraranger import TerarangerFrame
from pretouch_sensor_gateway.wire_formats.text import Modules, TextParser

AUTO = "auto"
"""The name that asks for detection."""
MAX_UNDETECTED = 8192
"""Bytes that are kept while the format is not certain. When there are more, they are discarded and detection
restarts."""

_END = re.compile(rb"[\0\r\n]")
"""What ends a frame or a line."""
_FAR = 1.99
"""Metres. 200 or more in a frame may well be millimetres, of a sensor that sees nothing nearer than 0.2 m."""
_INFERENCE_AFTER = (8, 12, 16, 24, 32, 48)
"""Lines from the first with a unit on after which a pattern is inferred: the presets come first, and other kinds of
lines may follow. Later it is tried after every `_LINES_KEPT` lines, for it takes a while."""
_LINES_KEPT = 60
_UNIT = re.compile(r"(?:^|[^A-Za-z])(?:mm|cm|m|(?:milli|centi)?met(?:er|re)s?)(?![A-Za-z])", re.IGNORECASE)


class AutoDetectingParser:
    """Detects the format of a connection from its first bytes (a `Parser`).

    Nothing is sent to a device before its format is known: a sketch that prints text may read what it gets as commands.
    Once the format is known, everything received since the connection began, or since bytes were last discarded, is
    parsed at once. Discarded bytes count as refused, once for each piece between zeros and line ends. After an outage
    detection restarts: another device may be on the port.

    Attributes:
        name: of the detected format, "" before.
    """

    def __init__(self, modules: Modules | None = None, no_target: tuple[object, ...] = ()) -> None:
        self.refused: Counter[Refusal] = Counter()
        self._modules = modules
        self._no_target = no_target
        self._parser: Parser | None = None
        self._detector = _Detector()
        self._held = bytearray()

    @property
    def name(self) -> str:
        return self._parser.name if self._parser else ""

    @property
    def unit(self) -> str:
        return self._parser.unit if self._parser else ""

    @property
    def two_way(self) -> bool:
        return self._parser is not None and self._parser.two_way

    @property
    def tick_modulus(self) -> int | None:
        return self._parser.tick_modulus if self._parser else None

    @property
    def problem(self) -> str:
        return self._parser.problem if self._parser else ""

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
        found = self._detector.add(piece)
        if isinstance(found, LineFormat):
            self._parser = TextParser(found.with_no_target(self._no_target), self._modules)
        elif found is not None:
            self._parser = found
        elif len(self._held) == MAX_UNDETECTED:
            self._discard()

    def _discard(self) -> None:
        pieces = _END.split(bytes(self._held))
        self.refused[Refusal.ENCODING] += sum(bool(piece.strip(BLANK)) for piece in pieces)
        self._held.clear()
        self._detector = _Detector()


def likely_benewake() -> BenewakeFrame:
    """Frames of Benewake as `auto` takes them: in centimetres, and none farther than a finger sees."""
    return BenewakeFrame("tf-luna", "cm", _FAR)


class _Detector:
    """Follows one connection from its start."""

    def __init__(self) -> None:
        self._binary = BinaryParser()
        self._fixed = (FixedFrameParser(likely_benewake()), FixedFrameParser(TerarangerFrame()))
        self._splitter = LineSplitter()
        self._lines: deque[str] = deque(maxlen=_LINES_KEPT)
        self._count = 0  # of the lines from the first with a unit on

    def add(self, piece: bytes) -> LineFormat | Parser | None:
        """The format, once it is certain. `piece` may contain one end of a frame or line, as its last byte."""
        if self._binary.feed(piece):
            return BinaryParser()
        for parser in self._fixed:
            parser.feed(piece)
            if parser.established:
                return FixedFrameParser(parser.kind)
        for line in self._splitter.feed(piece):
            found = self._add_line(line) if isinstance(line, str) and line else None
            if found is not None:
                return found
        return None

    def _add_line(self, line: str) -> LineFormat | None:
        self._lines.append(line)
        preset = next((each for each in TELLING if each.tells(line) and each.told_by(self._lines)), None)
        if preset is not None:
            return preset
        if not self._count and _UNIT.search(line) is None:
            return None
        self._count += 1
        if self._count not in _INFERENCE_AFTER and self._count % _LINES_KEPT:
            return None
        inference = infer(list(self._lines))
        if inference is None or inference.question or inference.pending:
            return None
        return LineFormat(inference.pattern, (inference.pattern,))
