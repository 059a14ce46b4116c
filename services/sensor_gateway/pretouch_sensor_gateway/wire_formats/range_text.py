"""What a number or a word on a line says of a range: how far, or that there was no target, or no answer."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property

from pretouch_sensor_gateway.wire_formats.parser import OK

NO_TARGET = 7
"""Status of a module without a range, where the device does not say why."""
NO_ANSWER = 255
"""Status of a module that did not answer in time."""
MAX_RANGE = 12.0
"""Metres. No sensor for a finger measures farther: more is a time, a count, or a range in another unit."""

Reading = tuple[float, int]
"""A range, m, NaN for none, and the module's status."""

METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
"""The units of ranges, in metres."""
UNIT_NAMES = {
    "mm": r"(?:mm|millimet(?:er|re)s?)",
    "cm": r"(?:cm|centimet(?:er|re)s?)",
    "m": r"(?:m|met(?:er|re)s?)",
}
"""How a line names each unit, as regular expressions."""
NUMBER = r"[+-]?(?:\d{1,15}(?:\.\d{0,12})?|\.\d{1,12})(?:e[+-]?\d{1,2})?"
DECIMAL_COMMA = r"[+-]?\d{1,15}(?:[.,]\d{1,12})?"
WORDS = (
    r"(?:[+-]?nan|[+-]?inf(?:inity)?|none|null|n/?a|oor|ovf|invalid|error|fail(?:ed)?"
    r"|no[ _-]?(?:target|object|echo|reading)|out[ _-]?of[ _-]?(?:range|bounds)|over[ _-]?range|too (?:far|close)"
    r"|time(?:d )?-?out|-{1,3})"
)
"""What libraries and sketches print in a range's place when there is none."""

_TIMEOUT = re.compile(r"time(?:d )?-?out", re.IGNORECASE)
_WORD = re.compile(WORDS, re.IGNORECASE)
_LEADING_NUMBER = re.compile(r"[+-]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:e[+-]?\d+)?", re.IGNORECASE)
_RAW = frozenset({8190.0, 8191.0, 65532.0, 65533.0, 65534.0, 65535.0})
"""What sensors return instead of a range, whatever the unit: VL53L0X and VL53L1X out of range, 16-bit -1 to -4 (TFmini:
weak, saturated, ambient light), a library's timeout."""
_NO_ANSWER = 65535.0
_OF_VL6180X = frozenset({255.0, 510.0, 765.0})
"""Full scale of the VL6180X at its scaling factors of 1, 2 and 3."""


@dataclass(frozen=True)
class RangeText:
    """How ranges are written in one format.

    Attributes:
        unit: mm, cm or m.
        full_scale: whether 255, 510 and 765 whole millimetres are a VL6180X's full scale, hence no target.
        no_target: further numbers and words, in small letters, that are no range.
    """

    unit: str
    full_scale: bool = True
    no_target: frozenset[str] = field(default_factory=frozenset)

    def pattern(self, decimal_comma: bool = False, with_unit: bool = False) -> str:
        """A regular expression of everything that `read` understands; `with_unit`: numbers must have their unit."""
        unit = rf"\s*{UNIT_NAMES[self.unit]}\b"
        number = rf"{DECIMAL_COMMA if decimal_comma else NUMBER}(?:\s+timeout)?{unit if with_unit else f'(?:{unit})?'}"
        further = "".join(f"|{re.escape(word)}" for word in sorted(self.no_target, key=len, reverse=True))
        return rf"(?:{number}(?:\s+timeout)?|(?:{WORDS}{further})(?:{unit})?)"

    def read(self, text: str) -> Reading | None:
        """The reading that `text` stands for; None if it is a number that cannot be a range, or an unknown word."""
        try:
            number = float(text)
        except ValueError:
            return self._read_word(text)
        if "_" in text or (math.isinf(number) and "inf" not in text.lower()):
            return None
        return self.read_number(number)

    def _read_word(self, text: str) -> Reading | None:
        if self._known.fullmatch(text) is None:
            return None
        if _TIMEOUT.search(text) is not None:
            return math.nan, NO_ANSWER
        match = _LEADING_NUMBER.match(text)
        if match is None or text.lower() in self.no_target:
            return math.nan, NO_TARGET
        return self.read_number(float(match[0].replace(",", ".")))

    @cached_property
    def _known(self) -> re.Pattern[str]:
        return re.compile(self.pattern(decimal_comma=True), re.IGNORECASE)

    def is_word(self, text: str) -> bool:
        """Whether all of `text` is a word for no target."""
        return _WORD.fullmatch(text.strip()) is not None

    def read_number(self, number: float) -> Reading | None:
        """The reading of a number in the format's unit."""
        if number != number or number <= 0 or number in self._numbers:
            return math.nan, NO_ANSWER if number == _NO_ANSWER else NO_TARGET
        metres = number / self._per_metre
        return (metres, OK) if metres <= MAX_RANGE else (math.nan, NO_TARGET) if number == math.inf else None

    @cached_property
    def _per_metre(self) -> int:
        # divided by, not multiplied with its reciprocal: 45.5 mm is 0.0455 m then, to the last bit
        return round(1 / METRES[self.unit])

    @cached_property
    def _numbers(self) -> frozenset[float]:
        """Numbers in the format's unit that are no range."""
        raw = _RAW | {value * self._per_metre / 1000 for value in _RAW}
        further = {float(value) for value in self.no_target if _LEADING_NUMBER.fullmatch(value)}
        return frozenset(raw | further | (_OF_VL6180X if self.full_scale and self.unit == "mm" else frozenset()))


def normalised(values: Iterable[object]) -> frozenset[str]:
    """Numbers and words that stand for no target, as `RangeText.no_target` holds them."""
    return frozenset(f"{value:g}" if isinstance(value, int | float) else str(value).lower() for value in values)
