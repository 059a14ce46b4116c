"""The binary wire format: nothing is lost that is whole, nothing is believed that is not."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pretouch_sensor_gateway.framing import END, MAX_FRAME, Decoder, Refusal, encode
from pretouch_sensor_gateway.messages import MAX_MODULES, BadLength, Message, Ping, PingReply, Ranges, pack

words = st.integers(0, 2**32 - 1)
metres = st.one_of(st.just(math.nan), st.integers(0, 0xFFFE).map(lambda steps: steps * 1e-4))
modules = st.lists(st.tuples(metres, st.integers(0, 255)), min_size=1, max_size=MAX_MODULES)
ranges = st.builds(
    lambda sequence, micros, m: Ranges(sequence, micros, *map(tuple, zip(*m, strict=True))), words, words, modules
)
messages = st.one_of(ranges, st.builds(Ping, words), st.builds(PingReply, words, words))


def cut(data: bytes, places: list[int]) -> list[bytes]:
    edges = [0, *sorted(min(place, len(data)) for place in places), len(data)]
    return [data[a:b] for a, b in itertools.pairwise(edges)]


def same(left: list[Message], right: list[Message]) -> bool:
    return [pack(m) for m in left] == [pack(m) for m in right]


@given(st.lists(messages, max_size=6), st.lists(st.integers(0, 1300), max_size=12))
def test_messages_come_back_however_their_bytes_are_cut(sent: list[Message], places: list[int]) -> None:
    decoder = Decoder()
    received = [message for piece in cut(b"".join(map(encode, sent)), places) for message in decoder.feed(piece)]
    assert same(received, sent)
    assert decoder.accepted == len(sent)
    assert decoder.refused.total() == 0


@given(st.lists(messages, min_size=1, max_size=4), st.data())
@settings(max_examples=300)
def test_a_flipped_bit_costs_its_frame_and_never_makes_another(sent: list[Message], data: st.DataObject) -> None:
    stream = bytearray(b"".join(map(encode, sent)))
    bit = data.draw(st.integers(0, 8 * len(stream) - 1))
    stream[bit // 8] ^= 1 << bit % 8
    decoder = Decoder()
    received = [pack(message) for message in decoder.feed(bytes(stream))]
    whole = [pack(message) for message in sent]
    assert received in [whole[:k] + whole[k + lost :] for k in range(len(whole)) for lost in (1, 2)]
    if stream[-1] == 0:  # else the last frame has not ended yet
        assert decoder.refused.total() >= 1


@given(st.binary(max_size=600), st.lists(st.integers(0, 600), max_size=4))
@example(b"\x00" * 50, [])
@example(b"\xff" * 600, [3])
def test_any_bytes_are_survived_and_the_next_frame_is_read(garbage: bytes, places: list[int]) -> None:
    decoder = Decoder()
    for piece in cut(garbage, places):
        decoder.feed(piece)
    assert same(decoder.feed(END + encode(Ping(7))), [Ping(7)])
    broken = [piece for piece in garbage.split(END) if piece]
    assert decoder.refused.total() + decoder.accepted == len(broken) + 1


def test_a_line_without_zeros_takes_no_memory_and_counts_once() -> None:
    decoder = Decoder()
    for _ in range(100):
        decoder.feed(b"\x01" * 1000)
        assert len(decoder._buffer) <= MAX_FRAME
    assert decoder.feed(END) == []
    assert decoder.refused == {Refusal.OVERSIZE: 1}


def test_the_longest_message_fits_the_longest_frame() -> None:
    longest = Ranges(2**32 - 1, 2**32 - 1, (6.5,) * MAX_MODULES, (255,) * MAX_MODULES)
    assert len(encode(longest)) - 1 == MAX_FRAME
    assert same(Decoder().feed(encode(longest)), [longest])
    with pytest.raises(BadLength):
        encode(Ranges(0, 0, (0.1,) * (MAX_MODULES + 1), (0,) * (MAX_MODULES + 1)))
    with pytest.raises(BadLength):
        encode(Ranges(0, 0, (), ()))


def framed(body: bytes) -> bytes:
    """A frame whose checksum is right, whatever it holds."""
    from cobs import cobs
    from fastcrc import crc16

    return cobs.encode(body + crc16.ibm_3740(body).to_bytes(2, "little")) + END


@pytest.mark.parametrize(
    ("body", "refusal"),
    [
        (b"\x02" + pack(Ping(1))[1:], Refusal.VERSION),
        (b"\x01\x7f" + pack(Ping(1))[2:], Refusal.KIND),
        (pack(Ping(1)) + b"\x00", Refusal.LENGTH),
        (pack(Ping(1))[:-1], Refusal.LENGTH),
        (pack(Ranges(0, 0, (0.1, 0.2), (0, 0)))[:-3], Refusal.LENGTH),
        (pack(Ranges(0, 0, (0.1,), (0,)))[:10] + b"\x00", Refusal.LENGTH),
    ],
)
def test_a_frame_that_is_whole_but_says_nothing_known_is_counted_by_reason(body: bytes, refusal: Refusal) -> None:
    decoder = Decoder()
    assert decoder.feed(framed(body)) == []
    assert decoder.refused == {refusal: 1}


@given(st.floats(0, 6.5))
def test_a_range_keeps_a_twentieth_of_a_millimetre(distance: float) -> None:
    (message,) = Decoder().feed(encode(Ranges(0, 0, (distance,), (0,))))
    assert isinstance(message, Ranges)
    assert abs(message.ranges[0] - distance) <= 0.5e-4 + 1e-12


def test_ranges_beyond_16_bits_are_held_and_none_stays_none() -> None:
    (message,) = Decoder().feed(encode(Ranges(0, 0, (-0.001, 9.0, math.nan), (14, 0, 7))))
    assert isinstance(message, Ranges)
    assert message.ranges[:2] == (0.0, 0xFFFE * 1e-4)
    assert math.isnan(message.ranges[2])


def test_the_readme_s_example_frames_are_what_the_code_sends() -> None:
    readme = (Path(__file__).parents[2] / "services/sensor_gateway/README.md").read_text()
    examples = {
        "one module, 34.5 mm, status 0": Ranges(5, 1_000_000, (0.0345,), (0,)),
        "ping 3": Ping(3),
        "its reply": PingReply(3, 1_000_500),
    }
    for name, message in examples.items():
        assert f"{encode(message).hex(' ')}" in readme, f"{name}: {encode(message).hex(' ')}"
