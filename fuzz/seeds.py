"""The fuzzer's first inputs."""

from __future__ import annotations

from pretouch_sensor_gateway.wire_formats.messages import pack

from fuzz.harness import KINDS, SEPARATOR
from fuzz.streams import MESSAGES, STREAMS


def seeds() -> list[bytes]:
    """Inputs of `harness.check_input`: every stream as what it is and as `auto`, whole and in small pieces."""
    inputs = [
        bytes([KINDS.index(kind), step]) + stream
        for name, streams in STREAMS.items()
        for stream in streams
        for kind in (name, "auto")
        for step in (3, 255)
    ]
    inputs.append(bytes([KINDS.index("framed"), 255]) + SEPARATOR.join(map(pack, MESSAGES)))
    inputs.append(bytes([KINDS.index("auto"), 99]) + b"rst:0x1 (POWERON_RESET)\r\n" * 330 + STREAMS["binary"][0])
    return inputs
