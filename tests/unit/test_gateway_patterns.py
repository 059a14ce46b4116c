"""Line patterns: what a user writes is understood or refused, and a line is read as it says."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pretouch_sensor_gateway.wire_formats.parser import Measurement
from pretouch_sensor_gateway.wire_formats.registry import create_parser
from pretouch_sensor_gateway.wire_formats.text import Modules, TextParser
from pretouch_sensor_gateway.zones import LAYOUTS, find_zones

from pretouch.errors import InvalidInput

NAN = math.nan


def read(pattern: str, *lines: str, no_target: tuple[object, ...] = ()) -> list[Measurement]:
    parser = create_parser(pattern, None, no_target)
    received = parser.feed("\n".join(("", *lines, "")).encode())
    return [message for message in received if isinstance(message, Measurement)]


def same(ranges: tuple[float, ...], expected: tuple[float, ...]) -> bool:
    return bool(np.array_equal(np.array(ranges), np.array(expected), equal_nan=True))


@pytest.mark.parametrize(
    ("pattern", "line", "ranges", "status", "micros"),
    [
        ("{time:ms},{range:mm},{status}", "700,92,0", (0.092,), (0,), 700_000),
        ("{time:ms},{range:mm},{status}", " 700 , 92 ,4", (NAN,), (4,), 700_000),
        ("{time:ms},{range:mm},{status}", "700,,0", (NAN,), (7,), 700_000),
        ("{time:us};{range:cm}", "700000;9.2", (0.092,), (0,), 700_000),
        ("{time:s} {range:m}", "0.7\t0.092", (0.092,), (0,), 700_000),
        ("{time:hms} {range:mm}", "00:00:01.250 92", (0.092,), (0,), 1_250_000),
        ("Ambient: {any} Range: {range:mm}", "ambient:613\tRANGE : 92", (0.092,), (0,), None),
        ("Distance: {range:mm} mm", "Distance: 92mm", (0.092,), (0,), None),
        ("Distance: {range:mm} mm", "Distance: out of range", (NAN,), (7,), None),
        ("Distance: {range:mm} mm", "Distance: TIMEOUT mm", (NAN,), (255,), None),
        ("{range:cm,}", "9,2", (0.092,), (0,), None),
        ("{ranges:cm,}", "9,2;10,5", (0.092, 0.105), (0, 0), None),
        ("{range:mm},{range:mm}", "92,112", (0.092, 0.112), (0, 0), None),
        ("{status},{range:mm}", "2,92", (NAN,), (2,), None),
        ("{range:mm} {status:5|9}", "92 9", (0.092,), (0,), None),
        ("{range:mm} {status:5|9}", "92 0", (NAN,), (7,), None),
        ("{range:mm} {status}", "92 Range Valid", (0.092,), (0,), None),
        ("{range:mm} {status}", "92 sigma", (NAN,), (7,), None),
        ("{{{range:mm}, {any}}}", "{92, more}", (0.092,), (0,), None),
        ("d={range:mm}( [{any}])?", "d=92 [x]", (0.092,), (0,), None),
        ("d={range:mm}( [{any}])?", "d=92", (0.092,), (0,), None),
        ("{time:ms}(;{range:mm}/{status})+", "5;92/0;93/4", (0.092, NAN), (0, 4), 5000),
    ],
)
def test_a_line_is_read_as_its_pattern_says(
    pattern: str, line: str, ranges: tuple[float, ...], status: tuple[int, ...], micros: int | None
) -> None:
    (measurement,) = read(pattern, line)
    assert same(measurement.ranges, ranges)
    assert (measurement.status, measurement.micros) == (status, micros)


@pytest.mark.parametrize(
    ("pattern", "line"),
    [
        ("{time:ms},{range:mm}", "700,92,5"),  # another column
        ("{time:ms},{range:mm}", "92"),
        ("{range:mm}", "92 cm"),
        ("{range:mm}", "9,2"),
        ("{range:m}", "92"),
        ("{range:mm}", "12001"),
        ("Distance: {range:mm} mm", "Distance: 92"),
        ("Distance: {range:mm} mm", "Distance: 9.2 cm"),
        ("{range:mm} {status}", "92"),
        ("d={range:mm}", "d=92 x"),
        ("{ranges:mm}", "1 2 3x"),
        ("a={range:mm}( b={range:mm})?", "a=92"),
    ],
)
def test_a_line_that_is_not_of_the_pattern_is_refused(pattern: str, line: str) -> None:
    assert read(pattern, line) == []


@pytest.mark.parametrize(
    ("pattern", "said"),
    [
        ("{time:ms}", "no range"),
        ("{range}", "no unit"),
        ("{range:in}", "in"),
        ("{range:mm} {range:cm}", "several units"),
        ("{range:mm} {speed}", "speed"),
        ("{time} {range:mm}", "no unit"),
        ("{time:ms} {time:ms} {range:mm}", "twice"),
        ("{ranges:mm} {range:mm}", "beside"),
        ("{range:mm} {", "brace"),
        ("{any} {any} {any} {any} {range:mm}", "4 times"),
        ("{range:mm}( {any})+", "repeats"),
    ],
)
def test_a_pattern_that_cannot_be_meant_is_refused_with_a_remedy(pattern: str, said: str) -> None:
    with pytest.raises(InvalidInput, match=said) as caught:
        create_parser(pattern)
    assert caught.value.remedy


@given(st.text("{}()?+[]ranges:mtie,. 0x", max_size=30))
def test_any_pattern_is_understood_or_refused(pattern: str) -> None:
    try:
        parser = create_parser("{range:mm}" + pattern)
    except InvalidInput:
        return
    parser.feed(b"\n1 2 3\n" + b"{ range 1,2 : " * 30 + b"\n")


def test_a_line_that_almost_matches_takes_no_time_to_speak_of() -> None:
    parser = create_parser("a {any} b {any} c {any} d {range:mm} e")
    assert parser.feed(b"\n" + b"a b c d " * 100 + b"\n") == []  # would take minutes if each skipped what it likes


def test_further_values_may_stand_for_no_range() -> None:
    measured = read("{range:mm}", "92", "9999", "9999.0", "no object", no_target=(9999, "no object"))
    assert [math.isnan(measurement.ranges[0]) for measurement in measured] == [False, True, True, True]


@pytest.mark.parametrize(
    ("unit", "step"), [("ms", 33_000), ("ms", 0.033), ("s", 33), ("us", 0.033), ("us", 33), ("ms", 0)]
)
def test_a_time_in_another_unit_than_stated_is_refused(unit: str, step: float) -> None:
    parser = create_parser(f"{{time:{unit}}} {{range:mm}}")
    received = parser.feed("".join(f"\n{1000 + step * k} 92" for k in range(30)).encode())
    assert len(received) <= 3
    assert "its time" in parser.problem


@pytest.mark.parametrize(("unit", "step"), [("ms", 33), ("s", 0.033), ("us", 33_000), ("ms", 3), ("s", 1)])
def test_a_time_may_wrap_and_keeps_its_unit(unit: str, step: float) -> None:
    wraps = {"ms": 2**32, "us": 2**32, "s": 4_294_967.296}[unit]
    lines = [f"{(wraps - 5 * step + step * k) % wraps:.3f} 92" for k in range(30)]
    measured = read(f"{{time:{unit}}} {{range:mm}}", *lines)
    assert len(measured) == 30
    modulus = create_parser(f"{{time:{unit}}} {{range:mm}}").tick_modulus
    assert modulus is not None
    micros = np.array([measurement.micros for measurement in measured])
    in_micros = step * {"ms": 1e3, "us": 1, "s": 1e6}[unit]
    np.testing.assert_allclose(np.diff(micros) % modulus, in_micros, atol=1001)


def test_two_sensors_in_turns_are_refused_once_that_shows_but_noise_is_not() -> None:
    rng = np.random.default_rng(3)
    steady = [f"{value:.0f}" for value in 92 + 2.5 * rng.standard_normal(5000)]
    assert len(read("{range:mm}", *steady)) == 5000
    coarse = [f"{value:.0f}" for value in rng.integers(9, 11, 5000)]  # the last digit of a sensor with steps of 1 cm
    assert len(read("{range:cm}", *coarse)) == 5000
    turns = [f"{(92 if k % 2 else 112) + rng.normal():.0f}" for k in range(200)]
    parser = create_parser("{range:mm}")
    assert len(parser.feed("\n".join(("", *turns, "")).encode())) < 13
    assert "in turns" in parser.problem


def test_modules_that_print_their_name_make_one_frame_and_one_that_is_away_does_not_answer() -> None:
    pattern = "S{module}: {range:mm}"
    measured = read(pattern, *["S2: 50", "S1: 40"] * 2, "S1: 41", "S1: 42", "S2: 52", "S3: 60", "S1: 43", "S2: 53")
    assert [measurement.ranges for measurement in measured[:1]] == [(0.04, 0.05)]
    assert measured[1].status == (0, 255)
    assert [measurement.ranges for measurement in measured[2:]] == [(0.042, 0.052), (0.043, 0.053)]
    stated = create_parser(pattern, Modules(3))
    assert stated.feed(b"\nS1: 40\nS2: 50\nS1: 41\nS2: 51\n") == []
    assert "3 modules" in stated.problem


def test_a_frame_of_rows_is_whole_or_refused() -> None:
    row = "1 2 3 4"
    frame = "\n".join([row] * 4) + "\n\n"
    parser = create_parser("vl53l5cx-rows-4x4")
    received = parser.feed(f"{row}\n\n{frame}{row}\n{row}\n\n{frame}{frame}".encode())
    assert [len(m.ranges) for m in received if isinstance(m, Measurement)] == [16, 16, 16]
    assert parser.refused.total() == 3
    assert len(parser.feed((row + "\n").encode() * 11)) == 1  # where the next frame begins nothing shows


@pytest.mark.parametrize("name", LAYOUTS)
def test_zones_look_where_the_data_sheet_says(name: str) -> None:
    layout = LAYOUTS[name]
    poses, modules = find_zones(name, printed_mirrored=False)
    beams = np.array([pose.rotation[:, 2] for pose in poses]).reshape(layout.side, layout.side, 3)
    angles = np.degrees(np.arctan2(beams[..., :2], beams[..., 2:]))
    step = np.array(layout.field_of_view) / layout.side
    np.testing.assert_allclose(np.diff(angles[..., 0], axis=1), step[0])
    np.testing.assert_allclose(np.diff(angles[..., 1], axis=0), step[1])
    np.testing.assert_allclose(angles.mean(axis=(0, 1)), 0, atol=1e-9)
    mirrored, _ = find_zones(name, printed_mirrored=True)
    np.testing.assert_allclose([pose.rotation[0, 2] for pose in mirrored], beams[:, ::-1, 0].ravel(), atol=1e-12)
    assert modules.count == layout.side**2


def test_a_wall_across_the_axis_is_flat_though_the_sensor_reports_distances_along_its_axis() -> None:
    poses, modules = find_zones("vl53l5cx-8x8", printed_mirrored=True)
    line_format = create_parser("sparkfun-vl53l5cx-8x8", modules)
    assert isinstance(line_format, TextParser)
    frame = ("\t100" * 8 + "\r\n") * 8 + "\r\n"
    (measurement,) = line_format.feed(("\r\n" + frame).encode())
    assert isinstance(measurement, Measurement)
    heights = [metres * pose.rotation[2, 2] for metres, pose in zip(measurement.ranges, poses, strict=True)]
    np.testing.assert_allclose(heights, 0.1)


def test_zones_of_an_unknown_sensor_are_refused() -> None:
    with pytest.raises(InvalidInput, match="vl99"):
        find_zones("vl99-8x8", printed_mirrored=False)
