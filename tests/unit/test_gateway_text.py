"""Devices that print text: what a line certainly says is taken, all else is refused and counted."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pretouch_sensor_gateway.wire_formats.line_splitter import MAX_LINE, LineSplitter
from pretouch_sensor_gateway.wire_formats.messages import MAX_MODULES
from pretouch_sensor_gateway.wire_formats.parser import DeviceMessage, Measurement, Parser, Refusal
from pretouch_sensor_gateway.wire_formats.registry import create_parser
from pretouch_sensor_gateway.wire_formats.text import Modules

NAN = math.nan
TEXT_FORMATS = ("millimetres", "time-millimetres", "millimetres-time", "adafruit-vl6180x-triple", "stm32duino")


def heard(name: str, *lines: str) -> tuple[list[DeviceMessage], Parser]:
    """What a device says that is heard from a line's start."""
    wire_format = create_parser(name)
    return wire_format.feed("\n".join(("", *lines, "")).encode()), wire_format


def only(name: str, line: str) -> Measurement:
    (measurement,), _ = heard(name, line)
    assert isinstance(measurement, Measurement)
    return measurement


def same(left: list[DeviceMessage], right: list[DeviceMessage]) -> bool:
    return [repr(m) for m in left] == [repr(m) for m in right]  # NaN does not equal itself


def alike(measurement: Measurement, ranges: tuple[float, ...], status: tuple[int, ...]) -> None:
    assert [None if math.isnan(r) else r for r in measurement.ranges] == [None if math.isnan(r) else r for r in ranges]
    assert measurement.status == status


@pytest.mark.parametrize(
    ("line", "ranges", "status"),
    [
        ("132", (0.132,), (0,)),
        ("132 45.5", (0.132, 0.0455), (0, 0)),
        ("132\t45.5", (0.132, 0.0455), (0, 0)),
        (" 132,45.5 ; 7 ", (0.132, 0.0455, 0.007), (0, 0, 0)),
        ("132,,45", (0.132, NAN, 0.045), (0, 7, 0)),
        (",132", (NAN, 0.132), (7, 0)),
        ("132,45,", (0.132, 0.045), (0, 0)),  # a loop that prints a comma after each number
        ("132, 45, ", (0.132, 0.045), (0, 0)),
        ("12000 0.5 .5 +7. 1e2", (12.0, 0.0005, 0.0005, 0.007, 0.1), (0,) * 5),
        ("0 -1 -0.5 255 255.0 510 765 8190 8191", (NAN,) * 9, (7,) * 9),
        ("254 256 511 764", (0.254, 0.256, 0.511, 0.764), (0,) * 4),
        ("65535 12 65534 65532", (NAN, 0.012, NAN, NAN), (255, 0, 7, 7)),
        ("nan NaN -nan inf OVF none null - -- ---", (NAN,) * 10, (7,) * 10),
        ("65535 TIMEOUT", (NAN,), (255,)),
        ("255 TIMEOUT 12 0 timeout", (NAN, 0.012, NAN), (255, 0, 255)),
        ("12 TIMEOUT", (NAN,), (255,)),
        ("12 out of range 13", (0.012, NAN, 0.013), (0, 7, 0)),
        ("12,TIMEOUT,13", (0.012, NAN, 0.013), (0, 255, 0)),
        ("255,TIMEOUT", (NAN, NAN), (7, 255)),
    ],
)
def test_millimetres_are_ranges_but_for_what_stands_for_none(
    line: str, ranges: tuple[float, ...], status: tuple[int, ...]
) -> None:
    measurement = only("millimetres", line)
    alike(measurement, ranges, status)
    assert (measurement.boot, measurement.sequence, measurement.micros) == (None, None, None)


@pytest.mark.parametrize(
    "line",
    [
        "12001",
        "12 12001",
        "9,2",
        "9,2 10,5",
        "9,2;10,5",
        "104233 132",
        "0x10",
        "12 mm",
        "Distance: 12",
        "----",
        ",",
        ";,",
        "1.2.3",
        "12 | 13",
        "12:13",
        "1" * 400,
        " ".join("1" * (MAX_MODULES + 1)),
        "VL53L0X test",
        "--12",
        "1 2 3 ok",
    ],
)
def test_a_line_with_anything_that_is_not_certain_is_no_measurement(line: str) -> None:
    received, wire_format = heard("millimetres", line)
    assert received == []
    assert wire_format.refused == {Refusal.FIELDS: 1}


def test_as_many_modules_as_the_binary_format_has_fit_on_a_line() -> None:
    assert len(only("millimetres", " ".join(["1234.25"] * MAX_MODULES)).ranges) == MAX_MODULES


@pytest.mark.parametrize(
    ("name", "line", "micros", "ranges"),
    [
        ("time-millimetres", "104233 132 45", 104_233_000, (0.132, 0.045)),
        ("time-millimetres", "104233.25,132,", 104_233_250, (0.132,)),
        ("time-millimetres", "0 132", 0, (0.132,)),
        ("millimetres-time", "132 45 104233", 104_233_000, (0.132, 0.045)),
        ("millimetres-time", "132;45;104233.5;", 104_233_500, (0.132, 0.045)),
        ("millimetres-time", "65535 TIMEOUT 12 77", 77_000, (NAN, 0.012)),
        ("time-millimetres", "4294967295 1", (2**32 - 1) * 1000, (0.001,)),
        ("time-millimetres", "4294967296 1", 0, (0.001,)),  # a 64-bit clock of milliseconds
    ],
)
def test_the_device_s_time_is_told_in_microseconds(
    name: str, line: str, micros: int, ranges: tuple[float, ...]
) -> None:
    measurement = only(name, line)
    assert measurement.micros == micros
    alike(measurement, ranges, measurement.status)
    assert create_parser(name).tick_modulus == 2**32 * 1000


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("time-millimetres", "104233"),
        ("time-millimetres", "-1 132"),
        ("time-millimetres", "nan 132"),
        ("time-millimetres", ",132"),
        ("time-millimetres", "132 45 104233"),
        ("millimetres-time", "104233"),
        ("millimetres-time", "104233 132 45"),
        ("millimetres-time", "132 45 TIMEOUT"),
    ],
)
def test_a_line_without_a_time_or_with_it_elsewhere_is_refused(name: str, line: str) -> None:
    received, wire_format = heard(name, line)
    assert received == []
    assert wire_format.refused == {Refusal.FIELDS: 1}


@pytest.mark.parametrize(
    ("line", "ranges", "status"),
    [
        ("97 : 55 : ### : 132", (0.055, NAN, 0.132), (0, 7, 0)),
        ("35(0) : 55 : 66 : 132", (0.055, 0.066, 0.132), (0, 0, 0)),
        ("1001(2) : 55 : TTT : #6", (0.055, NAN, NAN), (0, 255, 6)),
        ("1000(5) : 0 : 66 : 0", (NAN, 0.066, NAN), (255, 0, 255)),  # what did not answer is printed as zero
        ("1000(5) : ### : 66 : 12", (NAN, 0.066, NAN), (255, 0, 255)),
        ("100(0) : 120   : 8190#4 : 700#2", (0.12, NAN, NAN), (0, 4, 2)),  # a failed measurement is no range
        ("97 : 1#300 : -1", (NAN, NAN), (7, 7)),
        ("Addr: 30 Lux: 1.0(Something new)", (NAN,), (7,)),
        ("1000(A) : 1   : TTT : 2   : 9   ", (0.001, NAN, 0.002, NAN), (0, 255, 0, 255)),
        ("97 : 0", (NAN,), (7,)),
        ("Addr: 30 Lux: 12.30 Range: 55 Addr: 31 Lux: 0.00(No convergence)", (0.055, NAN), (0, 7)),
        ("Addr: 30 Lux: 1.0(ECE failure) Addr: 3A Lux: 2.0Signal/Noise error", (NAN, NAN), (6, 11)),
        ("Addr: 30 Lux: 1.0Range reading overflow", (NAN,), (15,)),
        (" Addr: 30 Lux: nan Range: 7", (0.007,), (0,)),
    ],
)
def test_adafruit_s_sketches_are_read_in_every_mode(
    line: str, ranges: tuple[float, ...], status: tuple[int, ...]
) -> None:
    measurement = only("adafruit-vl6180x-triple", line)
    alike(measurement, ranges, status)
    assert (measurement.boot, measurement.sequence, measurement.micros) == (None, None, None)


@pytest.mark.parametrize(
    "line",
    [
        "97",
        "97 :",
        "12:34:56",
        "x : 55",
        "97 : 55 : ##",
        "97 : 55 : 1234567",
        "35(4) : 1 : 2",
        "35(g) : 1",
        "Addr: 30 Lux: 1.0",
        "Addr: 30 Range: 5",
        "Starting...",
        "    T - Timed mode - Reads done one after another",
        "97 0:120 33          1:8190 34(TIMEOUT)",
    ],
)
def test_what_adafruit_s_sketches_say_besides_is_no_measurement(line: str) -> None:
    received, wire_format = heard("adafruit-vl6180x-triple", line)
    assert received == []
    assert wire_format.refused == {Refusal.FIELDS: 1}


def test_the_stm32duino_log_tells_time_count_ranges_and_status() -> None:
    line = "[00:04:54.034, 08749]      1243 [0]            1838 [4]            0 [0]            8191 [2]            "
    measurement = only("stm32duino", line)
    assert (measurement.boot, measurement.sequence, measurement.micros) == (None, 8749, 294_034_000)
    alike(measurement, (1.243, NAN, NAN, NAN), (0, 4, 7, 2))


@pytest.mark.parametrize(
    ("time", "micros"), [("23:59:59.999", 86_399_999_000), ("24:00:00.000", 0), ("49:00:00.001", 3_600_001_000)]
)
def test_the_stm32duino_log_s_hours_wrap_with_the_day(time: str, micros: int) -> None:
    assert only("stm32duino", f"[{time}, 1] 12 [0]").micros == micros
    assert create_parser("stm32duino").tick_modulus == 86_400_000_000


@pytest.mark.parametrize(
    "line",
    [
        "[00:04:54.034, 08749]",
        "[00:04:54.034, 08749] 12",
        "[00:04:54.034] 12 [0]",
        "04:54.034, 08749] 12 [0]",
        "[00:61:54.034, 1] 12 [0]",
        "[00:04:54.034, 1] 12 [0] 13",
    ],
)
def test_a_log_line_that_is_not_whole_is_no_measurement(line: str) -> None:
    received, wire_format = heard("stm32duino", line)
    assert received == []
    assert wire_format.refused == {Refusal.FIELDS: 1}


GOOD = {
    "millimetres": "{mm} 45.5",
    "time-millimetres": "1042{k:02d} {mm} 45.5",
    "millimetres-time": "{mm} 45.5 1042{k:02d}",
    "adafruit-vl6180x-triple": "97(0) : {mm} : 45",
    "stm32duino": "[00:04:54.0{k:02d}, 08749] {mm} [0] 45 [0]",
}


@pytest.mark.parametrize("name", TEXT_FORMATS)
def test_half_a_line_is_believed_neither_at_the_start_nor_after_a_cut(name: str) -> None:
    wire_format, line = create_parser(name), GOOD[name].format(mm=134, k=1).encode() + b"\r\n"
    assert wire_format.feed(line[1:]) == []
    assert wire_format.refused.total() == 1
    assert len(wire_format.feed(line)) == 1
    assert wire_format.feed(line[:-2]) == []
    wire_format.restart()
    assert wire_format.feed(b"\n") == []
    assert len(wire_format.feed(line)) == 1
    assert wire_format.refused.total() == 1


def ranges_of(received: list[DeviceMessage]) -> list[list[float]]:
    return [[round(r * 1000) for r in m.ranges] for m in received if isinstance(m, Measurement)]


def test_the_first_number_of_modules_that_two_lines_agree_on_stays() -> None:
    received, wire_format = heard("millimetres", "1 2 3", "1 2 4", "12 5", "1 6", "1 7", "1 2 8")
    assert ranges_of(received) == [[1, 2, 3], [1, 2, 4], [1, 2, 8]]
    assert wire_format.refused == {Refusal.FIELDS: 3}
    assert "'1 7'" in wire_format.problem and "3 modules" in wire_format.problem  # noqa: PT018


def test_a_damaged_first_line_does_not_decide() -> None:
    received, _ = heard("millimetres", "1 23", "1 2 4", "1 2 5", "1 2 6")
    assert ranges_of(received) == [[1, 23], [1, 2, 5], [1, 2, 6]]


def test_the_stated_number_of_modules_decides_from_the_first_line_on() -> None:
    wire_format = create_parser("millimetres", Modules(3))
    assert ranges_of(wire_format.feed(b"\n1 2\n1 3\n1 2 3\n")) == [[1, 2, 3]]
    assert "unplugged" in wire_format.problem


def test_after_a_cut_another_device_may_have_another_number_of_modules() -> None:
    _, wire_format = heard("millimetres", "1 2 3")
    wire_format.restart()
    assert len(wire_format.feed(b"\n1 2\n")) == 1


def test_what_is_not_printable_ascii_or_too_long_is_refused_by_reason() -> None:
    wire_format = create_parser("millimetres")
    data = b"\n1 2\n1\x002\n1 \xff\n\x1b[2J1 2\n" + b"1 " * 1000 + b"\r\n1 2\r\n"
    assert len(wire_format.feed(data)) == 2
    assert wire_format.refused == {Refusal.ENCODING: 3, Refusal.OVERSIZE: 1}


def test_a_line_that_never_ends_takes_no_memory_and_counts_once() -> None:
    lines = LineSplitter()
    lines.feed(b"\n")
    for _ in range(100):
        assert lines.feed(b"1" * 1000) == []
        assert len(lines._buffer) <= MAX_LINE
    assert lines.feed(b"\n1\n") == [Refusal.OVERSIZE, "1"]


@given(
    st.lists(st.integers(0, MAX_LINE + 2), max_size=5), st.sampled_from(["\n", "\r", "\r\n", "\n\n", "\r\r\n", " \n"])
)
@example([MAX_LINE, MAX_LINE + 1], "\r\n")
def test_every_line_end_ends_a_line_and_blank_lines_are_nothing(lengths: list[int], end: str) -> None:
    lines = LineSplitter()
    lines.feed(b"\n")
    heard_lines = lines.feed("".join("x" * length + end for length in lengths).encode())
    fits = MAX_LINE - end.count(" ")
    told = [line if isinstance(line, Refusal) else line.rstrip(" ") for line in heard_lines if line]
    assert told == ["x" * n if n <= fits else Refusal.OVERSIZE for n in lengths if n]


pieces = st.one_of(
    st.sampled_from([b"\n", b"\r", b"\r\n", b" ", b"\t", b"\0", b"\xff", b"1" * 600]),
    st.sampled_from([line.format(mm=120, k=3).encode() for line in GOOD.values()]),
    st.text("0123456789.,;:-# []()TNan", max_size=20).map(str.encode),
)


@pytest.mark.parametrize("name", TEXT_FORMATS)
@given(data=st.lists(pieces, max_size=20).map(b"".join), places=st.lists(st.integers(0, 900), max_size=6))
def test_any_bytes_give_the_same_however_they_are_cut_and_every_line_is_counted_once(
    name: str, data: bytes, places: list[int]
) -> None:
    whole, cut = create_parser(name), create_parser(name)
    received = whole.feed(data)
    edges = [0, *sorted(min(place, len(data)) for place in places), len(data)]
    assert same(received, [m for a, b in itertools.pairwise(edges) for m in cut.feed(data[a:b])])
    assert whole.refused == cut.refused
    ended = data.replace(b"\r", b"\n").split(b"\n")[:-1]
    assert len(received) + whole.refused.total() == sum(bool(line.strip(b" \t")) for line in ended)


@pytest.mark.parametrize("name", TEXT_FORMATS)
@given(st.lists(st.tuples(st.integers(1, 254), st.text("abc :,[]", max_size=10)), min_size=1, max_size=8))
def test_garbage_between_lines_costs_no_line(name: str, said: list[tuple[int, str]]) -> None:
    lines = [x for k, (mm, garbage) in enumerate(said) for x in (f"?{garbage}", GOOD[name].format(mm=mm, k=k))]
    received, wire_format = heard(name, *lines)
    assert [m.ranges[0] for m in received if isinstance(m, Measurement)] == [mm / 1000 for mm, _ in said]
    assert wire_format.refused == {Refusal.FIELDS: len(said)}


@given(
    st.lists(st.decimals(1, 8000, places=2), min_size=1, max_size=64),
    st.sampled_from([" ", "\t", ",", ";", ", ", " ; "]),
)
def test_numbers_come_out_as_they_went_in(numbers: list[object], separator: str) -> None:
    measurement = only("millimetres", separator.join(map(str, numbers)))
    none = {"255.00", "510.00", "765.00"}
    expected = tuple(NAN if str(number) in none else float(str(number)) / 1000 for number in numbers)
    alike(measurement, expected, tuple(7 if math.isnan(metres) else 0 for metres in expected))


def test_nothing_is_ever_sent_to_a_device_that_prints_text() -> None:
    assert not any(create_parser(name).two_way for name in TEXT_FORMATS)
