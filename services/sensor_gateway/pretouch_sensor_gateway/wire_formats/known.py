"""The formats that a device can speak, by the names that a configuration uses."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from pretouch_sensor_gateway.wire_formats.adafruit import read_adafruit
from pretouch_sensor_gateway.wire_formats.binary import BinaryFormat
from pretouch_sensor_gateway.wire_formats.millimetres import (
    MILLIS_MODULUS,
    read_millimetres,
    read_millimetres_time,
    read_time_millimetres,
)
from pretouch_sensor_gateway.wire_formats.received import WireFormat
from pretouch_sensor_gateway.wire_formats.stm32duino import DAY_MODULUS, read_stm32duino
from pretouch_sensor_gateway.wire_formats.text import TextFormat

KNOWN: Mapping[str, Callable[[], WireFormat]] = {
    "binary": BinaryFormat,
    "millimetres": lambda: TextFormat("millimetres", read_millimetres),
    "time-millimetres": lambda: TextFormat("time-millimetres", read_time_millimetres, MILLIS_MODULUS),
    "millimetres-time": lambda: TextFormat("millimetres-time", read_millimetres_time, MILLIS_MODULUS),
    "adafruit": lambda: TextFormat("adafruit", read_adafruit),
    "stm32duino": lambda: TextFormat("stm32duino", read_stm32duino, DAY_MODULUS),
}
