"""Reads lines of numbers: one range in millimetres for each module, and perhaps the device's time.

    132 45.5 255 8190          millimetres
    104233, 132, 45.5          time-millimetres: milliseconds since the start first
    132 45.5 104233            millimetres-time: milliseconds since the start last

`text_fields` decides which numbers and words are ranges, and which are none. A line with anything else is refused as a
whole.
"""

from __future__ import annotations

from pretouch_sensor_gateway.wire_formats.parser import Measurement
from pretouch_sensor_gateway.wire_formats.text import TextFormat
from pretouch_sensor_gateway.wire_formats.text_fields import parse_milliseconds, parse_reading, split_fields

MILLIS_MODULUS = 2**32 * 1000
"""Microseconds at which a 32-bit count of milliseconds wraps: 49.7 days."""


def read_millimetres(line: str) -> Measurement | None:
    """Reads a line of ranges."""
    return _measurement(split_fields(line), None)


def read_time_millimetres(line: str) -> Measurement | None:
    """Reads a line of a time and ranges."""
    words = split_fields(line)
    micros = parse_milliseconds(words[0]) if words else None
    return None if micros is None else _measurement(words[1:], micros % MILLIS_MODULUS)


def read_millimetres_time(line: str) -> Measurement | None:
    """Reads a line of ranges and a time."""
    words = split_fields(line)
    micros = parse_milliseconds(words[-1]) if words else None
    return None if micros is None else _measurement(words[:-1], micros % MILLIS_MODULUS)


def _measurement(words: list[str], micros: int | None) -> Measurement | None:
    readings = [parse_reading(word) for word in words]
    valid = [reading for reading in readings if reading is not None]
    if not any(words) or len(valid) < len(readings):
        return None
    ranges, status = zip(*valid, strict=True)
    return Measurement(None, None, micros, ranges, status)


FORMATS = (
    TextFormat("millimetres", read_millimetres),
    TextFormat("time-millimetres", read_time_millimetres, MILLIS_MODULUS),
    TextFormat("millimetres-time", read_millimetres_time, MILLIS_MODULUS),
)
