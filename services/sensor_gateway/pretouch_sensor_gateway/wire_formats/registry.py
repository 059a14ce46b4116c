"""A parser for each wire format, by the names that a configuration uses."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from importlib import import_module

from pretouch_sensor_gateway.wire_formats.binary import BinaryParser
from pretouch_sensor_gateway.wire_formats.parser import Parser
from pretouch_sensor_gateway.wire_formats.text import TextFormat, TextParser

_TEXT_MODULES = (
    "millimetres",
    "adafruit",
    "stm32duino",
)
"""Modules of this package, each with the `FORMATS` that it reads. `auto` detects the formats in this order."""

TEXT_FORMATS: tuple[TextFormat, ...] = tuple(
    text_format for name in _TEXT_MODULES for text_format in import_module(f"{__package__}.{name}").FORMATS
)
PARSERS: Mapping[str, Callable[[], Parser]] = {
    "binary": BinaryParser,
    **{text_format.name: partial(TextParser, text_format) for text_format in TEXT_FORMATS},
}
