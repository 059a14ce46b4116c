"""Reads log lines for the VL53L1X by users of the stm32duino library: time, count, each sensor's range and status.

    [00:04:54.034, 08749]      1243 [0]            1838 [4]

The time is that of the logging since the start, its hours taken modulo 24. The status is the sensor's own: of the
VL53L1X 0 good, 1 sigma, 2 signal, 4 out of bounds, 7 wrapped. A range with another status than 0 is passed on with it.
"""

from __future__ import annotations

import re

from pretouch_sensor_gateway.wire_formats.messages import COUNTER_MODULUS
from pretouch_sensor_gateway.wire_formats.parser import Measurement
from pretouch_sensor_gateway.wire_formats.text import TextFormat
from pretouch_sensor_gateway.wire_formats.text_fields import NO_ANSWER, make_reading

DAY_MODULUS = 24 * 3600 * 1_000_000
"""Microseconds of a day."""

_LINE = re.compile(
    r"\[(?P<hours>\d{2,6}):(?P<minutes>[0-5]\d):(?P<seconds>[0-5]\d)\.(?P<millis>\d{3}), *(?P<count>\d{1,10})\]"
    r"(?P<modules>(\s+\d{1,5} *\[\d{1,3}\])+)"
)
_MODULE = re.compile(r"(\d{1,5}) *\[(\d{1,3})\]")


def read_stm32duino(line: str) -> Measurement | None:
    """Reads a line of time, count, ranges and status."""
    match = _LINE.fullmatch(line)
    if match is None:
        return None
    valid = [make_reading(int(mm), int(status)) for mm, status in _MODULE.findall(match["modules"])]
    ranges, status = zip(*valid, strict=True)
    if max(status) > NO_ANSWER:
        return None
    seconds = (int(match["hours"]) * 60 + int(match["minutes"])) * 60 + int(match["seconds"])
    micros = (seconds * 1000 + int(match["millis"])) * 1000 % DAY_MODULUS
    return Measurement(None, int(match["count"]) % COUNTER_MODULUS, micros, ranges, status)


FORMATS = (TextFormat("stm32duino", read_stm32duino, DAY_MODULUS),)
