"""Creates parsers by what a configuration says of the format: `auto`, a preset's name, or a line pattern."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping
from types import MappingProxyType

from pretouch.errors import InvalidInput
from pretouch_sensor_gateway.wire_formats.auto_detection import AUTO, AutoDetectingParser
from pretouch_sensor_gateway.wire_formats.benewake import BenewakeFrame
from pretouch_sensor_gateway.wire_formats.binary import BinaryParser
from pretouch_sensor_gateway.wire_formats.fixed_frames import FixedFrameParser
from pretouch_sensor_gateway.wire_formats.line_format import LineFormat
from pretouch_sensor_gateway.wire_formats.parser import Parser
from pretouch_sensor_gateway.wire_formats.presets import PRESETS, RENAMED
from pretouch_sensor_gateway.wire_formats.teraranger import TerarangerFrame
from pretouch_sensor_gateway.wire_formats.text import Modules, TextParser

BINARY: Mapping[str, Callable[[], Parser]] = MappingProxyType(
    {
        "binary": BinaryParser,
        "tf-luna": lambda: FixedFrameParser(BenewakeFrame("tf-luna", "cm")),
        "tf-luna-mm": lambda: FixedFrameParser(BenewakeFrame("tf-luna-mm", "mm")),
        "teraranger-evo-binary": lambda: FixedFrameParser(TerarangerFrame()),
    }
)
"""The binary formats."""
FORMATS = (AUTO, *BINARY, *PRESETS)
"""The names of all formats, `AUTO` first."""


def create_parser(name: str, modules: Modules | None = None, no_target: tuple[object, ...] = ()) -> Parser:
    """Creates a parser of the format `name`: one of `FORMATS`, or a line pattern with braces (see `pattern`).

    Args:
        modules: what is known of the device's modules; None: nothing.
        no_target: further numbers and words that stand for no range in a text format.

    Raises:
        InvalidInput: there is no such format, or the pattern cannot be understood.
    """
    if name == AUTO:
        return AutoDetectingParser(modules, no_target)
    if name in BINARY:
        return BINARY[name]()
    return TextParser(find_line_format(name).with_no_target(no_target), modules)


def find_line_format(name: str) -> LineFormat:
    """The text format that `name` stands for: a preset, or a line pattern.

    Raises:
        InvalidInput: there is no such format, or the pattern cannot be understood.
    """
    if "{" in name:
        line_format = LineFormat(name, (name,))
        assert line_format.compiled
        return line_format
    if name in RENAMED:
        raise InvalidInput(f"The wire format {name!r} has another name now.", f"Choose {RENAMED[name]!r}.")
    if name not in PRESETS:
        near = difflib.get_close_matches(name, FORMATS, 3)
        meant = f" Did you mean {' or '.join(near)}?" if near else ""
        raise InvalidInput(
            f"There is no wire format {name!r}.{meant}",
            f"Choose one of {', '.join(FORMATS)}; or write a line with fields in it, as {{time:ms}},{{range:mm}}.",
        )
    return PRESETS[name]
