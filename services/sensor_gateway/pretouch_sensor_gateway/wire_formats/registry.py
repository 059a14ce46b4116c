"""A parser for each wire format, by the names that a configuration uses."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from pretouch_sensor_gateway.wire_formats.adafruit import read_adafruit
from pretouch_sensor_gateway.wire_formats.binary import BinaryParser
from pretouch_sensor_gateway.wire_formats.millimetres import (
    MILLIS_MODULUS,
    read_millimetres,
    read_millimetres_time,
    read_time_millimetres,
)
from pretouch_sensor_gateway.wire_formats.parser import Parser
from pretouch_sensor_gateway.wire_formats.stm32duino import DAY_MODULUS, read_stm32duino
from pretouch_sensor_gateway.wire_formats.text import TextParser

PARSERS: Mapping[str, Callable[[], Parser]] = {
    "binary": BinaryParser,
    "millimetres": lambda: TextParser("millimetres", read_millimetres),
    "time-millimetres": lambda: TextParser("time-millimetres", read_time_millimetres, MILLIS_MODULUS),
    "millimetres-time": lambda: TextParser("millimetres-time", read_millimetres_time, MILLIS_MODULUS),
    "adafruit": lambda: TextParser("adafruit", read_adafruit),
    "stm32duino": lambda: TextParser("stm32duino", read_stm32duino, DAY_MODULUS),
}
