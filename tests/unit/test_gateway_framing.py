"""The binary wire format: nothing is lost that is whole, nothing is believed that is not, and all is counted."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from cobs import cobs
from fastcrc import crc16
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pretouch_sensor_gateway.handshake import Handshake
from pretouch_sensor_gateway.wire_formats.binary import (
    END,
    INTERRUPT,
    MAX_FRAME,
    BinaryParser,
    FrameDecoder,
    encode,
)
from pretouch_sensor_gateway.wire_formats.messages import (
    MAX_FIRMWARE,
    MAX_MODULES,
    BadLength,
    Identify,
    Message,
    Ping,
    UnknownKind,
    UnknownVersion,
    pack,
    unpack,
)
from pretouch_sensor_gateway.wire_formats.parser import Identity, Measurement, PingReply, Refusal

words = st.integers(0, 2**32 - 1)
boots = st.integers(0, 2**16 - 1)
metres = st.one_of(st.just(math.nan), st.integers(0, 0xFFFE).map(lambda steps: steps * 1e-4))
modules = st.lists(st.tuples(metres, st.integers(0, 255)), min_size=1, max_size=MAX_MODULES)
measurements = st.builds(
    lambda boot, sequence, micros, m: Measurement(boot, sequence, micros, *map(tuple, zip(*m, strict=True))),
    *(boots, words, words, modules),
)
serials = st.one_of(st.just(""), st.binary(min_size=8, max_size=8).filter(any).map(bytes.hex))
firmwares = st.text([chr(code) for code in range(0x20, 0x7F)], max_size=MAX_FIRMWARE)
periods = words.map(lambda micros: micros * 1e-6)
identities = st.builds(Identity, boots, serials, st.integers(0, 255), periods, firmwares)
replies = st.builds(PingReply, boots, words, words)
from_device = st.one_of(measurements, replies, identities)
messages = st.one_of(from_device, st.builds(Ping, words), st.just(Identify()))


def cut(data: bytes, places: list[int]) -> list[bytes]:
    edges = [0, *sorted(min(place, len(data)) for place in places), len(data)]
    return [data[a:b] for a, b in itertools.pairwise(edges)]


def same(left: list[Message], right: list[Message]) -> bool:
    return [repr(m) for m in left] == [repr(m) for m in right]  # NaN does not equal itself


def ended(data: bytes) -> int:
    """How many frames that are not empty `data` ends."""
    return sum(bool(piece) for piece in data.split(END)[:-1])


def framed(body: bytes) -> bytes:
    """A frame whose checksum is right, whatever it holds."""
    return cobs.encode(body + crc16.ibm_3740(body).to_bytes(2, "little")) + END


@given(messages)
def test_every_message_comes_back_as_it_was_packed(message: Message) -> None:
    assert repr(unpack(pack(message))) == repr(message)


@given(st.lists(messages, max_size=6), st.lists(st.integers(0, 1300), max_size=12))
def test_messages_come_back_however_their_bytes_are_cut(sent: list[Message], places: list[int]) -> None:
    decoder = FrameDecoder()
    received = [message for piece in cut(b"".join(map(encode, sent)), places) for message in decoder.feed(piece)]
    assert same(received, sent)
    assert decoder.refused.total() == 0


@given(st.binary(max_size=900), st.lists(st.integers(0, 900), max_size=6))
@example(b"\x01" * 208 + END + b"\x01" * 209 + END, [208])
def test_any_bytes_give_the_same_however_they_are_cut(data: bytes, places: list[int]) -> None:
    whole, pieces = BinaryParser(), BinaryParser()
    received = [message for piece in cut(data, places) for message in pieces.feed(piece)]
    assert same(whole.feed(data), received)
    assert whole.refused == pieces.refused


@given(st.lists(st.one_of(from_device.map(encode), st.binary(min_size=1, max_size=300).map(lambda b: b + END))))
def test_every_frame_that_is_not_empty_is_delivered_or_counted_once(frames: list[bytes]) -> None:
    data = b"".join(frames)
    wire_format = BinaryParser()
    received = wire_format.feed(data)
    assert len(received) + wire_format.refused.total() == ended(data)


@given(st.lists(st.tuples(from_device, st.binary(max_size=300)), min_size=1, max_size=5))
def test_what_lies_between_frames_costs_at_most_the_frame_after_it(sent: list[tuple[Message, bytes]]) -> None:
    stream = b"".join(garbage + encode(message) for message, garbage in sent)
    received = [pack(message) for message in FrameDecoder().feed(stream)]
    clean = [pack(message) for message, garbage in sent if not garbage or garbage.endswith(END)]
    assert [body for body in received if body in clean] == clean


@given(st.lists(messages, min_size=1, max_size=4), st.data())
@settings(max_examples=300)
def test_a_flipped_bit_costs_its_frame_and_never_makes_another(sent: list[Message], data: st.DataObject) -> None:
    stream = bytearray(b"".join(map(encode, sent)))
    bit = data.draw(st.integers(0, 8 * len(stream) - 1))
    stream[bit // 8] ^= 1 << bit % 8
    decoder = FrameDecoder()
    received = [pack(message) for message in decoder.feed(bytes(stream))]
    whole = [pack(message) for message in sent]
    assert received in [whole[:k] + whole[k + lost :] for k in range(len(whole)) for lost in (1, 2)]
    if stream[-1] == 0:  # else the last frame has not ended yet
        assert decoder.refused.total() >= 1


@given(st.binary(max_size=600))
@example(b"\x00" * 50)
@example(b"\xff" * 600)
def test_any_bytes_are_survived_and_the_next_frame_is_read(garbage: bytes) -> None:
    decoder = FrameDecoder()
    decoder.feed(garbage)
    assert same(decoder.feed(END + encode(Ping(7))), [Ping(7)])


def test_a_line_without_zeros_takes_no_memory_and_counts_once() -> None:
    decoder = FrameDecoder()
    for _ in range(100):
        decoder.feed(b"\x01" * 1000)
        assert len(decoder._buffer) <= MAX_FRAME
    assert decoder.feed(END) == []
    assert decoder.refused == {Refusal.OVERSIZE: 1}


def test_the_longest_message_fits_the_longest_frame_and_a_longer_one_is_not_sent() -> None:
    longest = Measurement(2**16 - 1, 2**32 - 1, 2**32 - 1, (6.5,) * MAX_MODULES, (255,) * MAX_MODULES)
    assert len(encode(longest)) - 1 == MAX_FRAME
    assert same(FrameDecoder().feed(encode(longest)), [longest])
    for count in (0, MAX_MODULES + 1):
        with pytest.raises(ValueError, match="modules"):
            encode(Measurement(0, 0, 0, (0.1,) * count, (0,) * count))
    with pytest.raises(ValueError, match="boot, sequence and time"):
        encode(Measurement(None, 0, 0, (0.1,), (0,)))


ONE = pack(Measurement(0, 0, 0, (0.1, 0.2), (0, 0)))
WHO = pack(Identity(0, "", 1, 0.03, "x" * MAX_FIRMWARE))


@pytest.mark.parametrize(
    ("body", "refusal", "error"),
    [
        (b"\x02" + pack(Ping(1))[1:], Refusal.VERSION, UnknownVersion),
        (b"\x01\x7f" + pack(Ping(1))[2:], Refusal.KIND, UnknownKind),
        (pack(Ping(1)) + b"\x00", Refusal.LENGTH, BadLength),
        (pack(Ping(1))[:-1], Refusal.LENGTH, BadLength),
        (b"\x01", Refusal.LENGTH, BadLength),
        (ONE[:12], Refusal.LENGTH, BadLength),
        (ONE[:-3], Refusal.LENGTH, BadLength),
        (ONE + b"\x00", Refusal.LENGTH, BadLength),
        (ONE[:12] + b"\x00", Refusal.LENGTH, BadLength),
        (ONE[:12] + b"\x41" + b"\x01" * 195, Refusal.OVERSIZE, BadLength),
        (WHO[:24], Refusal.LENGTH, BadLength),
        (WHO + b"x", Refusal.LENGTH, BadLength),
    ],
)
def test_a_frame_that_is_whole_but_says_nothing_known_is_counted_by_reason(
    body: bytes, refusal: Refusal, error: type[ValueError]
) -> None:
    with pytest.raises(error):
        unpack(body)
    decoder = FrameDecoder()
    assert decoder.feed(framed(body)) == []
    assert decoder.refused == {refusal: 1}


@pytest.mark.parametrize(
    ("frame", "refusal"),
    [
        (b"\x09\x01" + END, Refusal.ENCODING),
        (cobs.encode(b"ab") + END, Refusal.LENGTH),
        (cobs.encode(pack(Ping(1)) + b"\x01\x02") + END, Refusal.CHECKSUM),
    ],
)
def test_a_frame_that_is_not_whole_is_counted_by_reason(frame: bytes, refusal: Refusal) -> None:
    decoder = FrameDecoder()
    assert decoder.feed(frame) == []
    assert decoder.refused == {refusal: 1}


def test_an_echo_of_the_gateways_own_words_is_no_device() -> None:
    wire_format = BinaryParser()
    assert wire_format.feed(encode(Ping(3)) + encode(Identify())) == []
    assert wire_format.refused == {Refusal.KIND: 2}


def test_half_a_frame_before_a_cut_spoils_no_frame_after_it() -> None:
    wire_format, reply = BinaryParser(), PingReply(1, 2, 3)
    wire_format.feed(encode(reply)[:-3])
    wire_format.restart()
    assert wire_format.feed(encode(reply)) == [reply]
    assert wire_format.refused.total() == 0


@given(st.floats(0, 6.5))
def test_a_range_keeps_a_twentieth_of_a_millimetre(distance: float) -> None:
    message = unpack(pack(Measurement(0, 0, 0, (distance,), (0,))))
    assert isinstance(message, Measurement)
    assert abs(message.ranges[0] - distance) <= 0.5e-4 + 1e-12


def test_ranges_beyond_16_bits_are_held_and_none_stays_none() -> None:
    message = unpack(pack(Measurement(0, 0, 0, (-0.001, 9.0, math.inf, math.nan), (14, 0, 0, 7))))
    assert isinstance(message, Measurement)
    assert message.ranges[:3] == (0.0, 0xFFFE * 1e-4, 0xFFFE * 1e-4)
    assert math.isnan(message.ranges[3])


def test_a_firmware_s_name_is_cut_to_what_fits_and_shown_as_printable_text() -> None:
    told = unpack(pack(Identity(0, "0102030405060708", 1, 0.03, "grün " * 10)))
    assert isinstance(told, Identity)
    assert told.firmware == ("gr?n " * 10)[:MAX_FIRMWARE]
    assert unpack(WHO[:25] + b"\x1b[2J\x7f\xff") == Identity(0, "", 1, 0.03, "?[2J??")


SPECIFICATION = (Path(__file__).parents[2] / "docs/reference/wire-formats.md").read_text()


def rows(after: str) -> Iterator[list[str]]:
    """The cells of the first table of the specification after `after`, without its head."""
    table = re.search(r"(?:^\|.*\n)+", SPECIFICATION[SPECIFICATION.index(after) :], re.MULTILINE)
    assert table is not None
    for line in table[0].splitlines()[2:]:
        yield [cell.strip() for cell in line.strip("|").split("|")]


def crc_as_specified(data: bytes) -> int:
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ (0x1021 if crc & 0x8000 else 0)) & 0xFFFF
    return crc


def encoded_as_specified(body: bytes) -> bytes:
    data = body + crc_as_specified(body).to_bytes(2, "little")
    return b"".join(bytes([len(block) + 1]) + block for block in data.split(b"\0")) + b"\0"


SPECIFIED_MESSAGES = {
    "ranges 5 at 1.000000 s: one module, 34.5 mm, status 0": Measurement(0x1234, 5, 1_000_000, (0.0345,), (0,)),
    "ping 7": Ping(7),
    "its reply at 1.000500 s": PingReply(0x1234, 7, 1_000_500),
    "identify": Identify(),
    'identity: serial 0102030405060708, 1 module, 33,333 us, "demo 1.0"': Identity(
        0x1234, "0102030405060708", 1, 0.033333, "demo 1.0"
    ),
}


def test_the_specification_s_example_frames_are_what_is_sent_and_read() -> None:
    assert crc_as_specified(b"123456789") == 0x29B1
    examples = {name: bytes.fromhex(frame.strip("`")) for name, frame in rows("Examples, byte for byte")}
    assert examples.keys() == SPECIFIED_MESSAGES.keys()
    for name, frame in examples.items():
        assert encode(SPECIFIED_MESSAGES[name]) == frame, name
        assert encoded_as_specified(pack(SPECIFIED_MESSAGES[name])) == frame, name
        (read,) = FrameDecoder().feed(frame)
        assert repr(read) == repr(SPECIFIED_MESSAGES[name]), name


@given(st.integers(0, 2**32 - 1), st.integers(1, 40))
def test_nothing_sent_to_a_device_interrupts_a_micropython_program(number: int, pings: int) -> None:
    handshake = Handshake(number)
    handshake.start(0.0)
    numbers = []
    for _ in range(pings):
        messages = handshake.take_due(handshake.next_send)
        assert INTERRUPT not in b"".join(map(encode, messages))
        numbers += [message.sequence for message in messages if isinstance(message, Ping)]
    assert len(set(numbers)) == pings
    assert same(FrameDecoder().feed(b"".join(encode(Ping(each)) for each in numbers)), list(map(Ping, numbers)))


def test_each_field_lies_where_the_specification_s_tables_say() -> None:
    def field(message: Message, table: str, name: str, k: int = 0) -> int:
        offset, size = next((row[0], row[1]) for row in rows(table) if row[2] == name)
        start, _, per_module = offset.partition(" + ")
        at = int(start) + (int(per_module.removesuffix("k")) * k if per_module else 0)
        return int.from_bytes(pack(message)[at : at + int(size)], "little")

    ranges = Measurement(0x1234, 0x11223344, 0x55667788, (0.1, math.nan), (0, 7))
    for name, value in {"version": 1, "kind": 1, "boot": 0x1234, "sequence": 0x11223344, "time": 0x55667788}.items():
        assert field(ranges, "starts with twelve bytes", name) == value, name
    assert field(ranges, "Ranges go on with", "n") == 2
    assert [field(ranges, "Ranges go on with", "range", k) for k in (0, 1)] == [1000, 0xFFFF]
    assert [field(ranges, "Ranges go on with", "status", k) for k in (0, 1)] == [0, 7]
    identity = Identity(1, "0102030405060708", 6, 0.033333, "demo")
    table = "Identity goes on with"
    assert field(identity, table, "serial").to_bytes(8, "little").hex() == identity.serial
    assert (field(identity, table, "n"), field(identity, table, "period")) == (6, 33_333)
    assert pack(identity)[25:] == b"demo"
