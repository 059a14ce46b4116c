"""A format of text lines: a pattern or several, and what their ranges, words and status codes mean."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import NamedTuple

from pretouch_sensor_gateway.wire_formats.parser import OK
from pretouch_sensor_gateway.wire_formats.pattern import TIME_UNITS, Field, Group, LinePattern, compile_pattern, unit_of
from pretouch_sensor_gateway.wire_formats.range_text import NO_ANSWER, NO_TARGET, RangeText, Reading, normalised

_GOOD_WORDS = frozenset({"ok", "okay", "valid", "good", "range valid", "rangevalid", "true", "yes"})
_MODULI = {"s": 2**32 * 1000, "ms": 2**32 * 1000, "us": 2**32, "hms": 24 * 3600 * 1_000_000}
"""Microseconds at which each kind of time wraps: a 32-bit count of milliseconds after 49.7 days, one of microseconds
after 71.6 minutes, a time of day after 24 hours."""
_WHOLE_MICROS = {unit: int(micros) for unit, micros in TIME_UNITS.items()}
_SEQUENCE_MODULUS = 2**32
_NUMBERS = re.compile(r"[-+.,;\d \t]*")
_SPLIT = re.compile(r"[ \t]*[,;][ \t]*|[ \t]+")
_LAST_SEPARATOR = re.compile(r"[ \t]*[,;]$")
_NUMERIC = re.compile(r"[-+.]?\d")
_TIME_NUMBER = re.compile(r"[\d.]+")


class LineReading(NamedTuple):
    """What a line says.

    Attributes:
        micros: the device's time, microseconds; None if the line has none.
        sequence: its count; None if it has none.
        module: the name of the module that it is of; None: the line is of all modules.
        readings: a range and a status for each module, or for the one.
        text: of the first range.
    """

    micros: int | None
    sequence: int | None
    module: str | None
    readings: tuple[Reading, ...]
    text: str


@dataclass(frozen=True)
class Misread:
    """Why a line that matches the pattern is no measurement, for users."""

    reason: str


@dataclass(frozen=True)
class LineFormat:
    """A line-based format.

    Attributes:
        name: as in a configuration.
        patterns: of the lines with ranges; all have the same unit and fields. See `pattern`.
        skipped: patterns of lines that the sketch prints besides: regular expressions of whole lines.
        no_target_lines: lines that stand for a measurement without a target: regular expressions of whole lines.
        full_scale: see `RangeText`.
        no_target: further numbers and words that are no range.
        status_of: the status code that each further word stands for, in small letters; 0 is good.
        rows: lines that one frame takes, ended by a blank line.
        exact: see `compile_pattern`.
        marked: what a line must be for `auto` to choose the format, as a regular expression.
        companion: a line that must have come too for `auto` to choose the format, as a regular expression.
        mirrored: whether a multizone sensor's rows are printed from right to left.
    """

    name: str
    patterns: tuple[str, ...]
    skipped: tuple[str, ...] = ()
    no_target_lines: tuple[str, ...] = ()
    full_scale: bool = True
    no_target: tuple[object, ...] = ()
    status_of: dict[str, int] = field(default_factory=dict, hash=False)
    rows: int = 1
    exact: bool = False
    marked: str = ""
    companion: str = ""
    mirrored: bool = False

    @cached_property
    def ranges(self) -> RangeText:
        words = frozenset(word for word, code in self.status_of.items() if code != OK)
        return RangeText(unit_of(self.patterns[0]), self.full_scale, normalised(self.no_target) | words)

    @cached_property
    def compiled(self) -> tuple[LinePattern, ...]:
        return tuple(compile_pattern(text, self.ranges, self.exact) for text in self.patterns)

    @property
    def unit(self) -> str:
        return self.ranges.unit

    @cached_property
    def time_unit(self) -> str | None:
        return self.compiled[0].time_unit

    @property
    def tick_modulus(self) -> int | None:
        """Microseconds at which the device's time wraps; None if it sends none."""
        return None if self.time_unit is None else _MODULI[self.time_unit]

    @property
    def names_modules(self) -> bool:
        """Whether a line is of one module, which it names."""
        return any(isinstance(each, Field) and each.kind == "module" for each in self.compiled[0].fields)

    @cached_property
    def decimal_comma(self) -> bool:
        """Whether commas in its ranges are decimal commas."""
        return ",}" in self.patterns[0]

    @cached_property
    def has_status(self) -> bool:
        """Whether its lines hold the status of their ranges."""
        return "{status" in self.patterns[0]

    @cached_property
    def takes_list(self) -> bool:
        """Whether a line has as many ranges as the device has modules."""
        return any(isinstance(each, Group) or each.kind == "ranges" for each in self.compiled[0].fields)

    def with_no_target(self, values: Iterable[object]) -> LineFormat:
        """This format with further numbers and words that are no range."""
        added = tuple(values)
        return replace(self, no_target=self.no_target + added) if added else self

    def skips(self, line: str) -> bool:
        """Whether the sketch prints this line besides its measurements."""
        return self._skipped is not None and self._skipped.fullmatch(line) is not None

    def read(self, line: str) -> LineReading | Misread | None:
        """What a line says; None if no pattern matches it."""
        for pattern in self.compiled:
            match = pattern.expression.fullmatch(line)
            if match is not None:
                plain = self._interpret_plain(pattern, match) if pattern.plain and not self.status_of else None
                return plain or self._interpret(pattern, match)
        if self._is_without_target(line):
            return LineReading(None, None, None, ((math.nan, NO_TARGET),), "")
        return None

    def tells(self, line: str) -> bool:
        """Whether a line shows that it is of this format, for `auto`."""
        if self.marked and re.fullmatch(self.marked, line) is None:
            return False
        return any(pattern.expression.fullmatch(line) for pattern in self.compiled)

    def _is_without_target(self, line: str) -> bool:
        """Whether the line stands for a measurement without a target, as "Out of range" does."""
        if self._without_target is not None and self._without_target.fullmatch(line):
            return True
        alone = self.time_unit is None and not self.names_modules and not self.takes_list
        return alone and self.ranges.is_word(line)

    def told_by(self, lines: Sequence[str]) -> bool:
        """Whether lines show together that they are of this format."""
        companion = not self.companion or any(re.fullmatch(self.companion, line.strip()) for line in lines)
        return companion and sum(map(self.tells, lines)) >= 2

    @cached_property
    def _skipped(self) -> re.Pattern[str] | None:
        return _any_of(self.skipped)

    @cached_property
    def _without_target(self) -> re.Pattern[str] | None:
        return _any_of(self.no_target_lines)

    def _interpret_plain(self, pattern: LinePattern, match: re.Match[str]) -> LineReading | None:
        """What a line of ranges, and perhaps a time, says, in a hurry; None if a range is odd."""
        micros = None
        texts: list[str] = []
        for each, text in zip(pattern.fields, match.groups(), strict=True):
            if text is None:
                return None
            if each.kind == "range":
                texts.append(text or "-")
            elif each.kind == "ranges":
                texts += split_list(text, each.argument.endswith(","))
            else:
                micros = _micros(text, each.argument)
        readings = [self.ranges.read(text) for text in texts]
        valid = tuple([reading for reading in readings if reading is not None])
        return LineReading(micros, None, None, valid, texts[0]) if len(valid) == len(texts) > 0 else None

    def _interpret(self, pattern: LinePattern, match: re.Match[str]) -> LineReading | Misread | None:
        micros = sequence = module = None
        pending = 0
        cells = _Cells()
        for each, text in zip(pattern.fields, match.groups(), strict=True):
            if each.kind == "range":
                cells.add_range(text)
            elif text is None:
                continue
            elif isinstance(each, Group):
                self._repeated(each, text, cells)
            elif each.kind == "ranges":
                cells.add_list(split_list(text, each.argument.endswith(",")))
            elif each.kind == "time":
                micros = _micros(text, each.argument)
            elif each.kind == "status":
                cells.add_status(self._status(text, each.argument))
            elif each.kind == "module":
                module = text.strip().lower()
            elif each.kind == "sequence":
                sequence = int(text) % _SEQUENCE_MODULUS
            elif each.kind == "pending":
                pending = int(text, 16)
        readings = self._readings(cells, pending)
        if not isinstance(readings, tuple):
            return readings
        return LineReading(micros, sequence, module, readings, cells.texts[0] or "")

    def _repeated(self, group: Group, text: str, cells: _Cells) -> None:
        for match in group.expression.finditer(text):
            repetition = _Cells()
            for each, part in zip(group.fields, match.groups(), strict=True):
                if each.kind == "range":
                    repetition.add_range(part)
                elif each.kind == "status" and part is not None:
                    repetition.add_status(self._status(part, each.argument))
            cells.texts += repetition.texts
            cells.codes += repetition.codes

    def _readings(self, cells: _Cells, pending: int) -> tuple[Reading, ...] | Misread | None:
        if pending >> len(cells.texts):
            return Misread("it says of more modules than it has that they did not answer")
        readings = []
        for k, (text, code) in enumerate(zip(cells.texts, cells.codes, strict=True)):
            if text is None and code is None:
                return Misread("a range is missing")
            reading = self._reading(text, code)
            if reading is None:
                if not text or _NUMERIC.match(text) is None:
                    return None  # a line of words
                return Misread(f"{text} is no range in {self.unit}: is it another unit, or another column?")
            readings.append((math.nan, NO_ANSWER) if pending and pending >> k & 1 else reading)
        return tuple(readings) or Misread("no range stands where the ranges should be")

    def _reading(self, text: str | None, code: int | None) -> Reading | None:
        """A range and its status: a measurement that failed is no range, whatever number comes with it."""
        if text is not None and text.lower() in self.status_of:
            return math.nan, self.status_of[text.lower()]
        metres, status = (math.nan, NO_TARGET) if text is None else self.ranges.read(text) or (math.inf, OK)
        if code not in (None, OK):
            return math.nan, int(code or NO_TARGET)
        return None if metres == math.inf else (metres, status)

    def _status(self, text: str, argument: str) -> int:
        """A status code of 8 bits, 0 if it is good."""
        word = text.strip().strip("()").strip().lower()
        if word in _good(argument):
            return OK
        if word in self.status_of:
            return self.status_of[word]
        number = int(word) if word.lstrip("-").isdecimal() else NO_TARGET
        return number if 0 < number < NO_ANSWER else NO_TARGET


class _Cells:
    """The texts of a line's ranges, and the status code of each; a status is of the ranges before it, or after it."""

    def __init__(self) -> None:
        self.texts: list[str | None] = []
        self.codes: list[int | None] = []
        self._status: int | None = None

    def add_range(self, text: str | None) -> None:
        self.texts.append("-" if text == "" else text)
        self.codes.append(self._status)

    def add_list(self, texts: list[str]) -> None:
        self.texts += texts
        self.codes += [self._status] * len(texts)

    def add_status(self, code: int) -> None:
        if None in self.codes:
            self.codes = [code if each is None else each for each in self.codes]
        else:
            self._status = code


def split_list(text: str, decimal_comma: bool) -> list[str]:
    """Splits a list of ranges at blanks and semicolons, and at commas unless these are decimal commas.

    Between two separators a field may be empty; one at the end is ignored. "TIMEOUT" belongs to the number before it,
    and words for no target such as "out of range" stay together.
    """
    if text.isdecimal():
        return [text]
    text = text.strip()
    if decimal_comma:
        text = re.sub(r"(?<=\d),(?=\d)", ".", text)
    text = _LAST_SEPARATOR.sub("", text)
    parts = _split_words(text)
    return [part or "-" for part in parts] if any(parts) else []


def _split_words(text: str) -> list[str]:
    if _NUMBERS.fullmatch(text):
        return _SPLIT.split(text)
    cells: list[str] = []
    for cell in re.split(r"[,;]", text):
        words: list[str] = []
        for word in cell.split() or [""]:
            joins = words and not word[:1].isdigit() and (word.lower() == "timeout" or _is_word(f"{words[-1]} {word}"))
            words[-1:] = [f"{words[-1]} {word}"] if joins else [*words[-1:], word]
        cells += words
    return cells


def _is_word(text: str) -> bool:
    return re.fullmatch(r"(?:out|out of|out of range|too|too far|too close|no|no target)", text, re.I) is not None


@cache
def _good(argument: str) -> frozenset[str]:
    """The status codes and words that are good, as a pattern names them."""
    return frozenset(argument.lower().split("|")) if argument else _GOOD_WORDS | {"0"}


def _micros(text: str, unit: str) -> int:
    if text.isdecimal() and unit != "hms":
        return int(text) * _WHOLE_MICROS[unit] % _MODULI[unit]
    if unit == "hms":
        hours, minutes, seconds = text.replace(",", ".").split(":")
        value = (int(hours) * 60 + int(minutes)) * 60 + float(seconds)
    else:
        match = _TIME_NUMBER.match(text)
        assert match is not None
        value = float(match[0])
    return round(value * TIME_UNITS[unit]) % _MODULI[unit]


def _any_of(expressions: tuple[str, ...]) -> re.Pattern[str] | None:
    return re.compile(rf"\s*(?:{'|'.join(expressions)})\s*", re.IGNORECASE) if expressions else None
