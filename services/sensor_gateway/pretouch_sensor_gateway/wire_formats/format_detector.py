"""Detects the wire format from the first bytes of a connection.

One binary frame with a correct checksum is sufficient, and so are two lines of a text format that are more than bare
numbers: nothing else looks like them. Lines of bare numbers need more, because one column may be the device's time:
`WINDOW` consecutive lines, all with the same number of columns. The first or the last column is a clock if it rises
evenly from every line to the next, by at least `MIN_STEP`; neither is a clock if each stands still or falls at least
`MIN_FALLS` times. The range of a finger that draws back rises too, but by less; the clock of a device that restarts
falls once. In any other case the format stays undecided.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum, auto
from itertools import pairwise

from pretouch_sensor_gateway.wire_formats import millimetres
from pretouch_sensor_gateway.wire_formats.binary import BinaryParser
from pretouch_sensor_gateway.wire_formats.line_splitter import LineSplitter
from pretouch_sensor_gateway.wire_formats.parser import Refusal
from pretouch_sensor_gateway.wire_formats.registry import TEXT_FORMATS
from pretouch_sensor_gateway.wire_formats.text_fields import parse_milliseconds, split_fields

WINDOW = 12
"""Lines of numbers that are classified together."""
MIN_STEP = 8_000
"""Least microseconds between two lines of a device that prints its time: no such sensor is faster than 125 Hz."""
MAX_UNEVENNESS = 4
"""Largest step of a clock relative to its least: a line may be late, and one or two may be lost."""
MIN_FALLS = 3
"""Steps within the window that do not rise, at least, in a column that is certainly no clock."""
_LINES_OF_ITS_OWN_KIND = 2
_OF_THEIR_OWN_KIND = [each for each in TEXT_FORMATS if each not in millimetres.FORMATS]


class _Trend(Enum):
    """How a column changes from line to line."""

    CLOCK = auto()
    RISING = auto()
    UNSURE = auto()
    NO_CLOCK = auto()


@dataclass(frozen=True)
class _Numbers:
    """A line of numbers: how many, the first and the last as microseconds, and which formats can read it."""

    columns: int
    first: int | None
    last: int | None
    readable: frozenset[str]


class FormatDetector:
    """Follows one connection from its start."""

    def __init__(self) -> None:
        self._binary = BinaryParser()
        self._lines = LineSplitter()
        self._of_its_own_kind: Counter[str] = Counter()
        self._window: deque[_Numbers] = deque(maxlen=WINDOW)

    def add(self, piece: bytes) -> str | None:
        """The format's name, once it is certain. `piece` may contain one end of a frame or line, as its last byte."""
        if self._binary.feed(piece):
            return "binary"
        names = [self._add_line(line) for line in self._lines.feed(piece)]
        return names[-1] if names else None

    def _add_line(self, line: str | Refusal) -> str | None:
        numbers = None if isinstance(line, Refusal) else _numbers(line)
        if numbers is not None:
            if self._window and self._window[-1].columns != numbers.columns:
                self._window.clear()
            self._window.append(numbers)
            return _classify(self._window) if len(self._window) == WINDOW else None
        self._window.clear()
        if isinstance(line, Refusal):
            return None
        for each in _OF_THEIR_OWN_KIND:
            if each.read(line) is not None:
                self._of_its_own_kind[each.name] += 1
                return each.name if self._of_its_own_kind[each.name] == _LINES_OF_ITS_OWN_KIND else None
        return None


def _numbers(line: str) -> _Numbers | None:
    readable = frozenset(each.name for each in millimetres.FORMATS if each.read(line) is not None)
    if not readable:
        return None
    words = split_fields(line)
    return _Numbers(len(words), parse_milliseconds(words[0]), parse_milliseconds(words[-1]), readable)


def _classify(window: Iterable[_Numbers]) -> str | None:
    lines = list(window)
    readable = frozenset.intersection(*(line.readable for line in lines))
    first, last = _trend([line.first for line in lines]), _trend([line.last for line in lines])
    rising = (_Trend.CLOCK, _Trend.RISING)
    if first is _Trend.CLOCK and last not in rising and "time-millimetres" in readable:
        return "time-millimetres"
    if last is _Trend.CLOCK and first not in rising and "millimetres-time" in readable:
        return "millimetres-time"
    if first is last is _Trend.NO_CLOCK and "millimetres" in readable:
        return "millimetres"
    return None


def _trend(column: list[int | None]) -> _Trend:
    times = [time for time in column if time is not None]
    if len(times) < len(column):
        return _Trend.NO_CLOCK
    steps = [after - before for before, after in pairwise(times)]
    falls = sum(step <= 0 for step in steps)
    if falls:
        return _Trend.NO_CLOCK if falls >= MIN_FALLS else _Trend.UNSURE
    steady = min(steps) >= MIN_STEP and max(steps) <= MAX_UNEVENNESS * min(steps)
    return _Trend.CLOCK if steady else _Trend.RISING
