"""Which format a device speaks is told by what it sends; nothing of it is lost, and doubt is not decided."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_sensor_gateway.wire_formats.auto_detection import MAX_UNDETECTED, AutoDetectingParser
from pretouch_sensor_gateway.wire_formats.binary import encode
from pretouch_sensor_gateway.wire_formats.messages import Ping
from pretouch_sensor_gateway.wire_formats.parser import DeviceMessage, Identity, Measurement, PingReply, Refusal
from pretouch_sensor_gateway.wire_formats.registry import BINARY, FORMATS, create_parser

from pretouch.errors import InvalidInput

NOISE = (0, 3, 1, 1, 2, 0, 4, 2, 2, 1, 3, 0)
"""Millimetres by which a range of a finger that rests differs from line to line."""
LINES = 12
"""Lines after which a pattern is inferred, also one with a time."""


def stream(line: Callable[[int], str], count: int = LINES) -> bytes:
    return "".join(f"{line(k)}\r\n" for k in range(count)).encode()


def rests(k: int) -> int:
    return 120 + NOISE[k % len(NOISE)]


def benewake(distance: int) -> bytes:
    frame = b"YY" + distance.to_bytes(2, "little") + b"\xb0\x04\x60\x09"
    return frame + bytes([sum(frame) % 256])


JSON = '{{"t": {time:ms}, "range_mm": {range:mm}}}'
DEVICES: dict[str, bytes] = {
    "binary": encode(Measurement(7, 0, 0, (0.03,), (0,))),
    "tf-luna": benewake(9) * 4,
    "pololu-vl53l1x-details": stream(
        lambda k: f"range: {rests(k)}\tstatus: range valid\tpeak signal: 7.31\tambient: 0.42", 2
    ),
    "adafruit-vl6180x-triple": stream(lambda k: f"97 : {rests(k)} : ### : 45", 2),
    "stm32duino": stream(lambda k: f"[00:00:00.{k:03d}, {k}] {rests(k)} [0]", 2),
    "tof: {range:mm} mm": stream(lambda k: f"tof: {rests(k)} mm", 8),
    JSON: stream(lambda k: f'{{"t": {5000 + 33 * k}, "range_mm": {rests(k)}}}'),
}
BOOT = b"\r\nets Jun  8 2016 00:22:57\r\n\r\nrst:0x1 (POWERON_RESET),boot:0x13\r\nVL6180X test!\r\n"


def end(name: str) -> bytes:
    """What ends whatever came before a device's first frame or line."""
    return b"\0" if name in BINARY else b"\n"


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
    assert len(recognition.feed(DEVICES[name])) >= len(create_parser(name).feed(data))


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


BARE: dict[str, Callable[[int], str]] = {
    "one": lambda k: f"{rests(k)}",
    "decimals": lambda k: f"{rests(k) / 10:.1f}",
    "metres": lambda k: f"{rests(k) / 1000:.2f}",
    "three": lambda k: f"{rests(k)} 45 {rests(k + 5)}",
    "time first": lambda k: f"{5000 + 33 * k},{rests(k)}",
    "time last": lambda k: f"{rests(k)};{5_000_000 + 33_000 * k}",
    "with a status": lambda k: f"{rests(k)},{4 * (k % 5 == 0)}",
    "labelled": lambda k: f"distance:{rests(k)},signal:62",
    "Range": lambda k: f"Range: {rests(k)}",
}


@pytest.mark.parametrize("name", BARE)
def test_a_unit_that_is_not_told_is_never_guessed(name: str) -> None:
    recognition = AutoDetectingParser()
    assert recognition.feed(b"\n" + stream(BARE[name], 2000)) == []
    assert recognition.name == recognition.unit == ""


@pytest.mark.parametrize(
    ("line", "name", "unit"),
    [
        (lambda k: f"Distance: {rests(k)} mm", "Distance: {range:mm} mm", "mm"),
        (lambda k: f"{rests(k) / 10:.1f} cm", "{range:cm} cm", "cm"),
        (lambda k: f"d = {rests(k) / 1000:.3f} metres", "d = {range:m} metres", "m"),
        (lambda k: f"dist_mm={rests(k)} light=61{k % 7}", "dist_mm={range:mm} light={number}", "mm"),
        (lambda k: f"{0.033 * k:.3f} s: range [mm] {rests(k)}", "{time:s} s: range [mm] {range:mm}", "mm"),
        (lambda k: f"t={1000 + 33 * k} range={rests(k)}mm", "t={time:ms} range={range:mm}mm", "mm"),
        (lambda k: f"{33000 * k + 7} us, range {rests(k)} mm", "{time:us} us, range {range:mm} mm", "mm"),
        (lambda k: f"n={k} range={rests(k)}mm", "n={number} range={range:mm}mm", "mm"),  # a count of lines is no time
        (lambda k: f"light={1000 + 33 * k} range={rests(k)}mm", "light={number} range={range:mm}mm", "mm"),
        (lambda k: f"range: {rests(k)} mm status: {4 * (k % 5 == 0)}", "range: {range:mm} mm status: {status}", "mm"),
        (lambda k: f"{rests(k)} mm / {rests(k) / 10:.1f} cm", "{range:mm} mm / {number} cm", "mm"),
        (lambda k: f"Sensor {1 + k % 2}: {rests(k)} mm", "Sensor {module}: {range:mm} mm", "mm"),
        (lambda k: f"tof{k % 3}: {rests(k)} mm", "tof{module}: {range:mm} mm", "mm"),
        (lambda k: f'{{"mm": [{rests(k)}, 45, null]}}', '{{"mm": [{ranges:mm}]}}', "mm"),
    ],
)
def test_a_line_that_tells_its_unit_gives_its_own_pattern(line: Callable[[int], str], name: str, unit: str) -> None:
    recognition = AutoDetectingParser()
    received = recognition.feed(b"\n" + stream(line, 3 * LINES))
    assert (recognition.name, recognition.unit) == (name, unit)
    assert len(received) >= LINES - 2  # three modules are one frame
    alone = create_parser(name).feed(b"\n" + stream(line, 3 * LINES))
    assert told(alone) == told(received)


@pytest.mark.parametrize(
    "line",
    [
        lambda k: f"raw {rests(k)} mm filtered {rests(k + 1)} mm",
        lambda k: f"range {rests(k)} mm sigma 1.{k % 3} mm",
        lambda k: f"height: {rests(k)} mm",
        lambda k: f"L: {rests(k)} mm R: {rests(k)} mm",
        lambda k: f"{'Left' if k % 2 else 'Right'}: {rests(k)} mm",
        lambda k: f"Abstand: {rests(k) // 10},{k % 10} cm",
        lambda k: f"Distance: {rests(k) / 25.4:.2f} in",
        lambda k: f"range: {rests(k)} mm status: {11 + k % 3}",
        lambda k: f"speed: {rests(k)} mm/s",
    ],
)
def test_in_doubt_which_number_is_the_range_nothing_is_decided(line: Callable[[int], str]) -> None:
    recognition = AutoDetectingParser()
    assert recognition.feed(b"\n" + stream(line, 200)) == []
    assert recognition.name == ""


def test_distances_that_may_be_in_millimetres_are_not_taken_for_centimetres() -> None:
    recognition = AutoDetectingParser()
    assert recognition.feed(b"".join(benewake(250 + k) for k in range(600))) == []
    assert recognition.name == ""


def test_a_table_with_a_header_tells_its_columns() -> None:
    recognition = AutoDetectingParser()
    head = b"\ntime_ms,distance_mm,status\n"
    received = recognition.feed(head + stream(lambda k: f"{1000 + 33 * k},{rests(k)},{4 * (k % 5 == 0)}", 15))
    assert recognition.name == "{time:ms},{range:mm},{status}"
    assert len(received) == 15


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
    assert recognition.feed(b"\n" + DEVICES["stm32duino"]) != []


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
    assert FORMATS[0] == "auto"
    assert {"binary", "millimetres", "time-millimetres", "millimetres-time", "stm32duino"} < set(FORMATS)
    for name in FORMATS[1:]:
        assert create_parser(name).name == name
        assert create_parser(name).unit in ("mm", "cm", "m")
        assert create_parser(name) is not create_parser(name)
    assert create_parser("auto").name == ""
    with pytest.raises(InvalidInput) as refused:
        create_parser("binray")
    assert "'binray'" in refused.value.detail
    assert "binary" in refused.value.detail
    assert all(name in refused.value.remedy for name in FORMATS)
    with pytest.raises(InvalidInput) as renamed:
        create_parser("adafruit")
    assert "adafruit-vl6180x-triple" in renamed.value.remedy
