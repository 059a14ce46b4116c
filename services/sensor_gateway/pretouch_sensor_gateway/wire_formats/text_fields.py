"""Parses a single number or word on a line: a range, no range, a time, or nothing that is certain."""

from __future__ import annotations

import math
import re

from pretouch_sensor_gateway.wire_formats.parser import OK

NO_TARGET = 7
"""Status of a module without a range, where the device does not say why."""
NO_ANSWER = 255
"""Status of a module that did not answer in time."""
MAX_MILLIMETRES = 6500
"""No sensor of this kind measures farther, and the binary format cannot hold more."""

Reading = tuple[float, int]
"""A range, m, NaN for none, and the module's status."""

_NUMBER = re.compile(r"[+-]?(\d{1,15}(\.\d{0,9})?|\.\d{1,9})")
_NO_RANGE_WORD = re.compile(r"-{0,3}|[+-]?nan|[+-]?inf|ovf|none|null", re.IGNORECASE)
_NO_RANGE_NUMBERS = {
    255: NO_TARGET,
    510: NO_TARGET,
    765: NO_TARGET,
    8190: NO_TARGET,
    8191: NO_TARGET,
    65535: NO_ANSWER,
}
"""What libraries return where there is no range: of the VL6180X 255 times its scaling of 1, 2 or 3, of the VL53L0X 8190
and 8191 out of range and 65535 after a timeout."""
_TIMEOUT = "timeout"


def split_fields(line: str) -> list[str]:
    """Splits a line without leading or trailing blanks into its fields: at blanks, commas or semicolons.

    Between two commas or semicolons a field may be empty; one at the end is ignored. "TIMEOUT" after a number
    that is no range belongs to that number.
    """
    cells = re.split(r"[,;]", line)
    if not cells[-1]:
        cells.pop()
    words = []
    for cell in cells:
        of_cell: list[str] = []
        for word in cell.split() or [""]:
            if word.lower() == _TIMEOUT and of_cell and _is_no_range_number(of_cell[-1]):
                of_cell.pop()
            of_cell.append(word)
        words += of_cell
    return words


def parse_reading(word: str) -> Reading | None:
    """Parses a word that stands for one module's range in millimetres, without a status; None: not certain.

    Numbers above 0 and up to `MAX_MILLIMETRES` are ranges, but for those that libraries return instead of one. These,
    zero and negative numbers, an empty field, up to three dashes and the words for "not a number" are no range. Any
    other number (a time in the wrong column?) or word is not certain.
    """
    if word.lower() == _TIMEOUT:
        return math.nan, NO_ANSWER
    if _NO_RANGE_WORD.fullmatch(word):
        return math.nan, NO_TARGET
    if not _NUMBER.fullmatch(word):
        return None
    if _is_no_range_number(word):
        return math.nan, _NO_RANGE_NUMBERS.get(int(float(word)), NO_TARGET)
    millimetres = float(word)
    return (millimetres / 1000, OK) if millimetres <= MAX_MILLIMETRES else None


def make_reading(millimetres: int, status: int) -> Reading:
    """The reading of a range whose status the device sends. An impossible range is none, even if its status is good."""
    if 0 < millimetres <= MAX_MILLIMETRES:
        return millimetres / 1000, status
    return math.nan, NO_TARGET if status == OK else status


def parse_milliseconds(word: str) -> int | None:
    """Parses a word that stands for a time in milliseconds, into microseconds; None if it is no time."""
    if not _NUMBER.fullmatch(word) or word.startswith("-"):
        return None
    return round(float(word) * 1000)


def _is_no_range_number(word: str) -> bool:
    return bool(_NUMBER.fullmatch(word)) and (float(word) <= 0 or float(word) in _NO_RANGE_NUMBERS)
