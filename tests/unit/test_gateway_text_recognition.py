"""Which format a device speaks is told by what it sends; nothing of it is lost, and doubt is not decided."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_sensor_gateway.wire_formats.auto_detection import (
    FORMATS,
    MAX_UNDETECTED,
    AutoDetectingParser,
    create_parser,
)
from pretouch_sensor_gateway.wire_formats.binary import encode
from pretouch_sensor_gateway.wire_formats.format_detector import WINDOW
from pretouch_sensor_gateway.wire_formats.messages import Ping
from pretouch_sensor_gateway.wire_formats.parser import DeviceMessage, Identity, Measurement, PingReply, Refusal

from pretouch.errors import InvalidInput

NOISE = (0, 3, 1, 1, 2, 0, 4, 2, 2, 1, 3, 0)
"""Millimetres by which a range of a finger that rests differs from line to line."""


def stream(line: Callable[[int], str], count: int = WINDOW) -> bytes:
    return "".join(f"{line(k)}\r\n" for k in range(count)).encode()


def rests(k: int) -> int:
    return 120 + NOISE[k % len(NOISE)]


DEVICES: dict[str, bytes] = {
    "binary": encode(Measurement(7, 0, 0, (0.03,), (0,))),
    "millimetres": stream(lambda k: f"{rests(k)} 45 {rests(k + 5)}"),
    "time-millimetres": stream(lambda k: f"{5000 + 33 * k} {rests(k)} 45"),
    "millimetres-time": stream(lambda k: f"{rests(k)} 45 {5000 + 33 * k}"),
    "adafruit": stream(lambda k: f"97 : {rests(k)} : ### : 45", 2),
    "stm32duino": stream(lambda k: f"[00:00:00.{k:03d}, {k}] {rests(k)} [0]", 2),
}
BOOT = b"\r\nets Jun  8 2016 00:22:57\r\n\r\nrst:0x1 (POWERON_RESET),boot:0x13\r\nVL6180X test!\r\n"


def end(name: str) -> bytes:
    """What ends whatever came before a device's first frame or line."""
    return b"\0" if name == "binary" else b"\n"


def told(received: list[DeviceMessage]) -> list[str]:
    return [repr(message) for message in received]


@pytest.mark.parametrize("before", [b"", b"0 7", b"\0\xff\xfe", BOOT, BOOT * 3 + b"\0"])
@pytest.mark.parametrize("name", DEVICES)
def test_every_format_is_recognised_behind_half_a_line_or_a_boot_loader_and_loses_nothing(
    name: str, before: bytes
) -> None:
    data = before + end(name) + DEVICES[name]
    recognition, alone = AutoDetectingParser(), create_parser(name)
    assert told(recognition.feed(data)) == told(alone.feed(data))
    assert recognition.name == name
    assert (recognition.two_way, recognition.tick_modulus) == (alone.two_way, alone.tick_modulus)
    assert recognition.refused == alone.refused


@pytest.mark.parametrize("name", DEVICES)
def test_nothing_is_known_or_sent_before_the_format_is_certain(name: str) -> None:
    recognition = AutoDetectingParser()
    data = end(name) + DEVICES[name]
    assert recognition.feed(data[:-2]) == []  # "\r" already ends the last line
    assert (recognition.name, recognition.two_way, recognition.tick_modulus) == ("", False, None)
    assert len(recognition.feed(data[-2:])) == len(create_parser(name).feed(data))
    assert recognition.name == name
    assert len(recognition.feed(DEVICES[name])) == len(create_parser(name).feed(data))


@given(st.sampled_from(sorted(DEVICES)), st.binary(max_size=40), st.lists(st.integers(0, 600), max_size=8))
def test_what_comes_out_does_not_depend_on_where_the_bytes_are_cut(name: str, before: bytes, places: list[int]) -> None:
    data = before + b"\0\n" + DEVICES[name] * 2
    whole, cut = AutoDetectingParser(), AutoDetectingParser()
    edges = [0, *sorted(min(place, len(data)) for place in places), len(data)]
    pieces = [message for a, b in itertools.pairwise(edges) for message in cut.feed(data[a:b])]
    assert told(whole.feed(data)) == told(pieces)
    assert (whole.name, whole.refused) == (cut.name, cut.refused)


@pytest.mark.parametrize(
    "message", [PingReply(1, 2, 3), Identity(1, "", 1, 0.03, "demo"), Measurement(1, 2, 3, (0.1,), (0,))]
)
def test_one_whole_frame_of_any_kind_is_proof_of_the_binary_format(message: DeviceMessage) -> None:
    recognition = AutoDetectingParser()
    assert recognition.feed(encode(message)) == [message]
    assert recognition.name == "binary"


def test_an_echo_is_no_proof() -> None:
    recognition = AutoDetectingParser()
    assert recognition.feed(encode(Ping(1)) * 20) == []
    assert recognition.name == ""


def lines_of(*columns: Callable[[int], int]) -> bytes:
    return b"\n" + stream(lambda k: " ".join(str(column(k)) for column in columns), 40)


@pytest.mark.parametrize(
    ("columns", "name"),
    [
        ([rests], "millimetres"),
        ([lambda k: 120], "millimetres"),
        ([lambda k: 120 - k], "millimetres"),
        ([rests, lambda k: 33], "millimetres"),
        ([lambda k: 1000 + 10 * k, rests], "time-millimetres"),
        ([lambda k: 1000 + 100 * k + 5 * NOISE[k % 12], rests], "time-millimetres"),  # uneven, at 10 Hz
        ([lambda k: 1000 + 33 * k + 66 * (k > 5), rests], "time-millimetres"),  # two lines were lost
        ([lambda k: 2**32 - 1000 + 33 * k, rests], "time-millimetres"),  # 49 days after its start
        ([rests, rests, lambda k: 1_700_000_000_000 + 33 * k], "millimetres-time"),
    ],
)
def test_a_column_that_rises_evenly_by_milliseconds_is_the_device_s_time(
    columns: list[Callable[[int], int]], name: str
) -> None:
    recognition = AutoDetectingParser()
    assert len(recognition.feed(lines_of(*columns))) == 40
    assert recognition.name == name


@pytest.mark.parametrize(
    "columns",
    [
        [lambda k: 60 + 2 * k],  # a finger that draws back, or a clock without ranges
        [lambda k: k, rests],  # a count of lines
        [lambda k: 60 + 2 * k, rests],
        [lambda k: 1000 + 33 * k, lambda k: 100 + 50 * k],  # two clocks
        [lambda k: 1000 + 33 * k + 500 * (k // 3), rests],  # rises unevenly
        [lambda k: 104233 + 33 * k, lambda k: 200_000 + 33 * k],
        [lambda k: 7000 + k % 2, rests],  # no range, and no clock
    ],
)
def test_in_doubt_nothing_is_decided_and_nothing_comes_out(columns: list[Callable[[int], int]]) -> None:
    recognition = AutoDetectingParser()
    assert recognition.feed(lines_of(*columns)) == []
    assert recognition.name == ""


def test_a_finger_that_draws_back_is_recognised_when_it_rests() -> None:
    recognition = AutoDetectingParser()
    assert recognition.feed(b"\n" + stream(lambda k: f"{60 + 2 * k} {61 + 2 * k}", 20)) == []
    assert len(recognition.feed(stream(lambda k: f"{rests(k)} {rests(k)}"))) == 20 + WINDOW
    assert recognition.name == "millimetres"


@pytest.mark.parametrize("starts", [1, 2])
def test_a_start_while_listening_does_not_turn_the_time_into_a_range(starts: int) -> None:
    recognition = AutoDetectingParser()
    recognition.feed(b"\n")
    for start in range(starts):
        recognition.feed(stream(lambda k, start=start: f"{3000 - 9 * start + 33 * k} {rests(k)}", 4))
    recognition.feed(stream(lambda k: f"{33 * k} {rests(k)}", 2 * WINDOW))
    assert recognition.name == "time-millimetres"


def test_lines_of_differing_numbers_of_columns_are_no_format() -> None:
    recognition = AutoDetectingParser()
    assert recognition.feed(b"\n" + stream(lambda k: f"{rests(k)} 45 {rests(k)}"[: 6 + 4 * (k % 2)], 100)) == []
    assert recognition.name == ""


def test_text_between_lines_of_numbers_makes_them_no_format() -> None:
    recognition = AutoDetectingParser()
    assert recognition.feed(b"\n" + stream(lambda k: f"Lux: 12\n{rests(k)}", 100)) == []
    assert recognition.name == ""


def test_bytes_that_nothing_can_read_fill_no_memory_and_are_counted() -> None:
    recognition = AutoDetectingParser()
    for _ in range(5):
        assert recognition.feed(b"Lux: 12\r\n" * (MAX_UNDETECTED // 9) + b"#" * (MAX_UNDETECTED % 9)) == []
    assert recognition.refused == {Refusal.ENCODING: 5 * (MAX_UNDETECTED // 9 + 1)}
    assert recognition.feed(b"\n" + DEVICES["adafruit"]) != []


def test_a_line_that_never_ends_fills_no_memory() -> None:
    recognition = AutoDetectingParser()
    for _ in range(100):
        assert recognition.feed(b"\x01" * 1000) == []
        assert len(recognition._held) < MAX_UNDETECTED
    assert recognition.refused == {Refusal.ENCODING: 100_000 // MAX_UNDETECTED}


@pytest.mark.parametrize(("first", "second"), list(itertools.permutations(DEVICES, 2)))
def test_after_a_cut_another_device_is_recognised_and_the_counts_go_on(first: str, second: str) -> None:
    recognition = AutoDetectingParser()
    recognition.feed(b"?" + end(first) + DEVICES[first] + b"half a li")
    before = recognition.refused.total()
    assert before >= 1
    recognition.restart()
    assert (recognition.name, recognition.two_way, recognition.tick_modulus) == ("", False, None)
    data = end(second) + DEVICES[second]
    assert told(recognition.feed(data)) == told(create_parser(second).feed(data))
    assert recognition.name == second
    assert recognition.refused.total() >= before


def test_what_was_held_when_the_line_was_cut_is_counted() -> None:
    recognition = AutoDetectingParser()
    recognition.feed(b"\n" + stream(lambda k: f"{rests(k)}", 3))
    recognition.restart()
    assert recognition.refused == {Refusal.ENCODING: 3}


@given(st.binary(max_size=3000))
@settings(max_examples=50)
def test_noise_is_hardly_ever_taken_for_a_device(noise: bytes) -> None:
    recognition = AutoDetectingParser()
    assert recognition.feed(noise) == []
    assert recognition.name == ""


def test_formats_are_known_by_name() -> None:
    assert ("auto", *DEVICES) == FORMATS
    for name in FORMATS[1:]:
        assert create_parser(name).name == name
        assert create_parser(name) is not create_parser(name)
    assert create_parser("auto").name == ""
    with pytest.raises(InvalidInput) as refused:
        create_parser("binray")
    assert "'binray'" in refused.value.detail
    assert all(name in refused.value.remedy for name in FORMATS)
