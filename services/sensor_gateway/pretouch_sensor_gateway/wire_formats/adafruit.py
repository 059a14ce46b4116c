"""Reads what Adafruit's example sketches for several sensors print (`vl6180x_triple`, `vl53l0x_multi_extended`).

    97 : 55 : ### : 132                          milliseconds that the cycle took, then ranges in mm; ###: none
    35(2) : 55 : TTT : #6                        a mask of the sensors that did not answer, in hexadecimal; #6: status 6
    35(0) : 120   : 8190#4                       as the VL53L0X sketch prints it in continuous mode: range and status
    Addr: 30 Lux: 12.30 Range: 55 Addr: 31 Lux: 0.00(No convergence)      the mode that vl6180x_triple starts in

None of them has a time: how long a cycle took is no clock. The other modes of the VL53L0X sketch are not read.
"""

from __future__ import annotations

import math
import re

from pretouch_sensor_gateway.wire_formats.parser import OK, Measurement
from pretouch_sensor_gateway.wire_formats.text import TextFormat
from pretouch_sensor_gateway.wire_formats.text_fields import NO_ANSWER, NO_TARGET, Reading, make_reading

_HEAD = re.compile(r"\d{1,10}(?:\(([0-9A-Fa-f]{1,16})\))?")
_RANGE = re.compile(r"(\d{1,5})(?:#(\d{1,3}))?")
_STATUS = re.compile(r"#(\d{1,3})")
_DEFAULT_MODE = re.compile(r"[0-9A-Fa-f]{1,2} Lux: [0-9a-z.+-]{1,16}(?: Range: (?P<range>\d{1,3})|(?P<words>[^0-9]*))")
_STATUS_OF_WORDS = {
    "(System error)": 1,
    "(ECE failure)": 6,
    "(No convergence)": 7,
    "(Ignoring range)": 8,
    "Signal/Noise error": 11,
    "Raw reading underflow": 12,
    "Raw reading overflow": 13,
    "Range reading underflow": 14,
    "Range reading overflow": 15,
}


def read_adafruit(line: str) -> Measurement | None:
    """Reads a line of ranges in any of the modes above."""
    if line.startswith("Addr: "):
        return _measurement([_default_mode(part) for part in (" " + line).split(" Addr: ")[1:]])
    head, *cells = re.split(" +: +", line)
    match = _HEAD.fullmatch(head)
    if match is None or not cells:
        return None
    pending = int(match[1] or "0", 16)
    if pending >> len(cells):
        return None
    return _measurement([_cell(cell, bool(pending >> k & 1)) for k, cell in enumerate(cells)])


def _cell(cell: str, pending: bool) -> Reading | None:
    if cell == "TTT":
        return math.nan, NO_ANSWER
    if cell == "###":
        return math.nan, NO_ANSWER if pending else NO_TARGET
    if match := _STATUS.fullmatch(cell):
        return make_reading(0, int(match[1]))
    if match := _RANGE.fullmatch(cell):
        # A sensor that did not answer leaves a zero, or the range of the cycle before.
        return (math.nan, NO_ANSWER) if pending else make_reading(int(match[1]), int(match[2] or OK))
    return None


def _default_mode(part: str) -> Reading | None:
    match = _DEFAULT_MODE.fullmatch(part)
    if match is None:
        return None
    if match["range"]:
        return make_reading(int(match["range"]), OK)
    status = _STATUS_OF_WORDS.get(match["words"])
    return None if status is None else (math.nan, status)


def _measurement(readings: list[Reading | None]) -> Measurement | None:
    valid = [reading for reading in readings if reading is not None and reading[1] <= NO_ANSWER]
    if len(valid) < len(readings):
        return None
    ranges, status = zip(*valid, strict=True)
    return Measurement(None, None, None, ranges, status)


FORMATS = (TextFormat("adafruit", read_adafruit),)
