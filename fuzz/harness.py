"""The invariants of every wire format, for any input."""

from __future__ import annotations

import math
import re
from collections import Counter, deque
from collections.abc import Iterable

from cobs import cobs
from fastcrc import crc16
from pretouch_sensor_gateway.wire_formats.auto_detection import AUTO, MAX_UNDETECTED
from pretouch_sensor_gateway.wire_formats.binary import MAX_FRAME
from pretouch_sensor_gateway.wire_formats.line_splitter import BLANK, MAX_LINE
from pretouch_sensor_gateway.wire_formats.messages import COUNTER_MODULUS, MAX_FIRMWARE, MAX_MODULES
from pretouch_sensor_gateway.wire_formats.parser import OK, DeviceMessage, Identity, Measurement, Parser, Refusal
from pretouch_sensor_gateway.wire_formats.presets import PRESETS
from pretouch_sensor_gateway.wire_formats.registry import FORMATS, create_parser

from fuzz.streams import BARE, STREAMS

KINDS = ("framed", *FORMATS)
"""What an input's bytes stand for: a format's stream, or bodies of the binary format without checksum and framing."""
SEPARATOR = b"\xff\xfe"
"""Between the bodies of a `framed` input."""

_MAX_PIECES = 200
_MAX_HELD = {AUTO: MAX_UNDETECTED + MAX_FRAME + MAX_LINE + 16, "binary": MAX_FRAME}
_COUNTED = {
    "binary",
    *(
        name
        for name, line_format in PRESETS.items()
        if line_format.rows == 1 and not line_format.skipped and not line_format.names_modules
    ),
}
"""Formats of which each frame or line that is not blank is either a message or refused."""


def check_input(raw: bytes) -> None:
    """Checks what `raw` stands for: a byte for the kind, one for the length of the pieces, then the stream.

    Raises:
        AssertionError: an invariant does not hold.
    """
    if len(raw) < 2:
        return
    kind = KINDS[raw[0] % len(KINDS)]
    if kind == "framed":
        check("binary", b"".join(map(_frame, raw[2:].split(SEPARATOR))), raw[1] + 1)
    else:
        check(kind, raw[2:], raw[1] + 1)


def check(name: str, data: bytes, step: int) -> None:
    """Checks the format `name` on `data`, fed at once and in pieces of `step` bytes, longer if they are too many.

    Raises:
        AssertionError: an invariant does not hold.
    """
    whole, pieces = create_parser(name), create_parser(name)
    received = whole.feed(data)
    in_pieces: list[DeviceMessage] = []
    step = max(step, len(data) // _MAX_PIECES)
    for start in range(0, len(data), step):
        in_pieces += pieces.feed(data[start : start + step])
        assert _measure_held(pieces) <= _MAX_HELD.get(name, MAX_LINE), "it keeps more than it may"
    assert _describe(received) == _describe(in_pieces), "it depends on where the bytes are cut"
    assert (whole.refused, whole.name) == (pieces.refused, pieces.name), "it depends on where the bytes are cut"
    for message in received:
        _check_values(message, whole)
    if name == AUTO:
        _check_detection(data)
    elif name in _COUNTED:
        assert len(received) + whole.refused.total() == _count_ended(name, data), "it loses count"
    _check_recovery(name, whole, data)


def _check_values(message: DeviceMessage, parser: Parser) -> None:
    """A message holds only values that its type promises."""
    if isinstance(message, Identity):
        assert message.firmware == "" or message.firmware.isprintable()
        assert len(message.firmware) <= MAX_FIRMWARE
    if not isinstance(message, Measurement):
        assert parser.two_way
        return
    assert 1 <= len(message.ranges) == len(message.status) <= MAX_MODULES
    assert all(0 <= status <= 255 for status in message.status)
    assert message.sequence is None or 0 <= message.sequence < COUNTER_MODULUS
    assert (message.micros is None) == (parser.tick_modulus is None)
    assert message.micros is None or 0 <= message.micros < (parser.tick_modulus or 0)
    for metres, status in zip(message.ranges, message.status, strict=True):
        assert math.isnan(metres) or 0 <= metres <= (6.5535 if parser.two_way else 65.535)
        assert parser.two_way or metres > 0 or status != OK, "a good status without a range"


def _check_detection(data: bytes) -> None:
    """Once recognised, all of the round comes out as the format alone would give it; before, all is counted."""
    parser = create_parser(AUTO)
    given_up: Counter[Refusal] = Counter()
    for start in range(0, len(data), MAX_UNDETECTED):
        block = data[start : start + MAX_UNDETECTED]
        received = parser.feed(block)
        if parser.name:
            if parser.name == "tf-luna":
                return  # `auto` believes shorter distances only
            alone = create_parser(parser.name)
            received += parser.feed(data[start + MAX_UNDETECTED :])
            assert _describe(received) == _describe(alone.feed(data[start:])), "it lost something"
            assert parser.refused == given_up + alone.refused, "it loses count"
            return
        assert (received, parser.two_way, parser.tick_modulus) == ([], False, None)
        if len(block) == MAX_UNDETECTED:
            given_up[Refusal.ENCODING] += _count_pieces(re.split(rb"[\0\r\n]", block))
        assert parser.refused == given_up, "it loses count"


def _check_recovery(name: str, parser: Parser, data: bytes) -> None:
    """A good stream of frames is read after anything, and every stream after a cut as if nothing had come before."""
    told = STREAMS.get(parser.name)
    if told and parser.two_way:
        stream = told[len(data) % len(told)]
        assert _describe(parser.feed(b"\0\n" + stream))[-1] == _ALONE[stream][-1], "it does not recover"
    parser.restart()
    assert _measure_held(parser) == 0, "it keeps something over a cut"
    telling = [stream for each, streams in STREAMS.items() if each not in BARE for stream in streams]
    after = telling if name == AUTO else STREAMS.get(name)
    if not after:
        return
    stream = after[len(data) % len(after)]
    assert _describe(parser.feed(stream)) == _ALONE[stream], "it hears what came before a cut"


def _count_ended(name: str, data: bytes) -> int:
    """How many frames or lines that are not empty `data` ends."""
    if name == "binary":
        return sum(map(bool, data.split(b"\0")[:-1]))
    return _count_pieces(re.split(rb"[\r\n]", data)[:-1])


def _count_pieces(pieces: Iterable[bytes]) -> int:
    return sum(bool(piece.strip(BLANK)) for piece in pieces)


def _describe(received: Iterable[DeviceMessage]) -> list[str]:
    return [repr(message) for message in received]  # NaN does not equal itself


_ALONE = {
    stream: _describe(create_parser(name).feed(stream)) for name, streams in STREAMS.items() for stream in streams
}
"""What each good stream says when nothing comes before it."""


def _frame(body: bytes) -> bytes:
    encoded: bytes = cobs.encode(body + crc16.ibm_3740(body).to_bytes(2, "little"))
    return encoded + b"\0"


def _measure_held(thing: object) -> int:
    """Bytes that `thing` and everything in it hold."""
    if isinstance(thing, bytes | bytearray):
        return len(thing)
    if isinstance(thing, list | tuple | deque):
        return sum(map(_measure_held, thing))
    return (
        sum(map(_measure_held, vars(thing).values()))
        if hasattr(thing, "__dict__") and not isinstance(thing, type)
        else 0
    )
