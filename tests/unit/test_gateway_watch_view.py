"""What the screen and the log say of a gateway."""

from __future__ import annotations

import math
import re
from datetime import datetime

import pytest
from helpers.watched_gateway import PORT, device, module, ranges, status
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_sensor_gateway.watch.log_lines import log_lines
from pretouch_sensor_gateway.watch.state import Watch
from pretouch_sensor_gateway.watch.view import View
from rich.console import Console

from pretouch.v1 import sensor_gateway_pb2 as pb

T0 = 1.7e9
WALL = 1_763_700_000.0


def drawn(watch: Watch, width: int = 80, height: int = 24, now: float = 100.0) -> list[str]:
    """The lines of the screen; there are as many as it has, and none is too wide."""
    console = Console(width=width, height=height, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    with console.file:
        console.print(View(watch, now, WALL), end="")
    said = console.export_text().split("\n")
    assert len(said) == height
    assert max(map(len, said)) <= width
    return [line.rstrip() for line in said]


def line_of(screen: list[str], label: str) -> str:
    """The line that begins with `label`, and those that go on with it."""
    first = next(k for k, line in enumerate(screen) if line.strip().startswith(label))
    last = first + 1
    while screen[last].startswith(" " * 10) and screen[last].strip():
        last += 1
    return " ".join(line.strip() for line in screen[first:last])


def six_modules() -> Watch:
    watch = Watch("127.0.0.1:50053")
    watch.take_devices([device()], 0.0)
    (finger,) = watch.devices
    counts = device(frames=1_235_752, lost_frames=7, bad_frames=5)
    modules = [module(jumps=k) for k in range(6)]
    recording = pb.RecordingStatus(on=True, path="recordings/finger.mcap", bytes=12_345_678)
    finger.take_status(status(counts, refused={"checksum": 3, "length": 2}, modules=modules, recording=recording), 1.0)
    for k in range(300):
        metres = [0.0345, 0.1203, 0.05, 0.05 + 0.03 * math.sin(k / 20), 0.05, 0.05]
        codes = [0, 0, 7 if k >= 150 else 0, 0, 255, 6]
        flags = [2, 0, 0, 1, 0, 0]
        finger.take_ranges(ranges([T0 + k / 30], [metres], [codes], [flags]), 90.0 + k / 30)
    return watch


@pytest.mark.parametrize("width", [80, 100, 120, 200])
def test_a_device_in_good_health_is_told_in_full(width: int) -> None:
    screen = drawn(six_modules(), width)
    assert "127.0.0.1:50053" in screen[0]
    assert datetime.fromtimestamp(WALL).strftime("%H:%M:%S") in screen[0]
    assert line_of(screen, "state") == "state    ● streaming at 30.0 Hz for 0:01:39 · epoch 3 · opened 2 times"
    assert PORT in line_of(screen, "port")
    for fact in ("binary", "0102030405060708", "fingertip 1.0", "6 modules at 30 Hz"):
        assert fact in line_of(screen, "device")
    for fact in ("1,235,752 good", "7 lost", "5 refused (checksum 3, length 2)", "0 untimed", "0 overrun"):
        assert fact in line_of(screen, "frames")
    for fact in ("synchronised", "+12.3 ppm", "0.18 ms", "round trip 0.92 ms"):
        assert fact in line_of(screen, "clock")
    for fact in ("on", "recordings/finger.mcap", "12.3 MB", "0 unrecorded"):
        assert fact in line_of(screen, "record")
    assert screen[-1] == " q quits"


@pytest.mark.parametrize("width", [80, 120])
def test_each_module_has_its_range_status_gauges_and_counts(width: int) -> None:
    screen = drawn(six_modules(), width)
    titles = next(k for k, line in enumerate(screen) if line.split()[:2] == ["#", "mm"])
    rows = screen[titles + 1 : titles + 7]
    assert [row.split()[0] for row in rows] == list("012345")
    assert [row.split()[1] for row in rows] == ["34.5", "120.3", "-", "70.6", "-", "-"]
    meant = ["ok, warming up", "ok", "7 no target", "ok, jump", "255 absent", "6 no early convergence"]
    for row, words in zip(rows, meant, strict=True):
        assert f" {words} " in row
    assert "▶" in rows[1]
    sparklines = [re.findall(r"[▁▂▃▄▅▆▇·]{12,}", row)[-1] for row in (rows[2], rows[4])]
    assert set(sparklines[1]) == {"·"}
    assert set(sparklines[0][-12:]) == {"·"}
    assert len(set(re.findall(r"[▁▂▃▄▅▆▇]{12,}", rows[3])[-1])) == 7
    assert [row.split(" %")[0].split()[-1] for row in rows] == ["100", "100", "50", "100", "0", "0"]
    assert [row.split()[-1] for row in rows] == list("012345")


def test_a_wide_terminal_shows_more() -> None:
    screen = drawn(six_modules(), 120)
    titles = next(line for line in screen if line.split()[:2] == ["#", "mm"])
    assert titles.split()[-6:] == ["returns", "per", "s", "of", "all", "jumps"]
    module_3 = next(line for line in screen if line.startswith("  3 "))
    assert module_3.split()[-6:] == ["100", "%", "30.0", "90", "%", "3"]


def test_frames_that_are_missing_leave_a_gap_in_the_sparkline() -> None:
    watch = Watch("host:1")
    watch.take_devices([device()], 0.0)
    watch.devices[0].take_status(status(), 0.0)
    for t in (*range(0, 60), *range(90, 121)):
        watch.devices[0].take_ranges(ranges([T0 + t / 30], [[0.05]]), 100 + t / 30)
    row = next(line for line in drawn(watch, now=104.0) if line.startswith("  0 "))
    assert re.search(r"▁{8} {4}▁{4}", row)


def test_when_nothing_comes_any_more_the_sparkline_moves_on() -> None:
    watch = six_modules()
    row = next(line for line in drawn(watch, now=160.0) if line.startswith("  3 "))
    assert not re.search(r"[▁▂▃▄▅▆▇]{12}", row)
    assert row.split()[-2:] == ["-", "3"]


def test_a_problem_is_told_where_the_state_is() -> None:
    watch = Watch("host:1")
    watch.take_devices([device()], 0.0)
    problem = "There is no device at /dev/ttyUSB0: it is not plugged in, or it has another name."
    unknown = pb.ClockStatus(synchronised=False)
    of = device(state=pb.DEVICE_STATE_CONNECTING, problem=problem)
    watch.devices[0].take_status(
        status(of, format="", identity=None, clock=unknown, connections=1, host_clock_jumps=1, untimed=3), 50.0
    )
    screen = drawn(watch)
    assert line_of(screen, "state") == "state    ● connecting for 0:00:50 · epoch 3 · opened once"
    assert line_of(screen, "problem").split(maxsplit=1)[1] == problem
    assert line_of(screen, "device").split(maxsplit=1)[1] == "format not recognised yet"
    assert "not synchronised" in line_of(screen, "clock")
    assert "1 host jump" in line_of(screen, "clock")
    assert "3 untimed" in line_of(screen, "frames")
    assert line_of(screen, "record").split() == ["record", "off"]


def test_events_come_with_their_times_and_the_last_ones_stay() -> None:
    watch = six_modules()
    for k in range(12):
        watch.devices[0].take_status(status(epoch=4 + k), 91.0 + k / 2)
    watch.devices[0].take_ranges(ranges([T0], [[0.05] * 6], lost=3), 97.0)
    watch.devices[0].take_ranges(ranges([T0], [[0.05] * 6], lost=4), 99.0)
    said = [line for line in drawn(watch, height=40) if re.match(r" \d\d:\d\d:\d\d ", line)]
    times = [datetime.fromtimestamp(WALL + at - 100.0).strftime("%H:%M:%S") for at in (99.0, 97.0)]
    assert len(said) == 8
    assert said[-1] == f" {times[0]} 7 frames lost in 2 gaps, since {times[1]}"
    assert said[-2].endswith("restarted: epoch 15")


def test_devices_are_told_apart_and_the_one_that_is_looked_at_is_shown() -> None:
    watch = Watch("host:1")
    watch.take_devices([device("thumb"), device("index")], 0.0)
    for known, port in zip(watch.devices, ("/dev/a", "/dev/b"), strict=True):
        of = device(known.name)
        of.port = port
        known.take_status(status(of), 1.0)
    assert "/dev/a" in line_of(drawn(watch), "port")
    watch.step(1)
    screen = drawn(watch)
    assert "/dev/b" in line_of(screen, "port")
    assert "1 thumb ●" in screen[0]
    assert "2 index ●" in screen[0]
    assert "index: streaming" in "\n".join(screen)
    assert "Tab" in screen[-1]


def test_of_many_devices_the_one_that_is_looked_at_is_named() -> None:
    watch = Watch("host:1")
    watch.take_devices([device(f"finger-{k}") for k in range(30)], 0.0)
    watch.select(7)
    assert "8 finger-7 ● of 30" in drawn(watch)[0]


def test_a_gateway_that_is_not_heard_is_told_with_the_wait() -> None:
    watch = Watch("host:1")
    assert "Connecting" in drawn(watch)[1]
    watch.take_failure("No gateway answers at host:1: Connection refused.", 103.5, 100.0)
    assert drawn(watch)[1].strip() == "No gateway answers at host:1: Connection refused. Trying again in 4 s."
    watch.take_devices([], 101.0)
    assert drawn(watch)[1].strip() == "The gateway has no device."


def test_what_was_known_stays_in_sight_while_the_gateway_is_away() -> None:
    watch = six_modules()
    watch.take_failure("No gateway answers.", 101.0, 100.0)
    screen = drawn(watch)
    assert "No gateway answers." in screen[1]
    assert PORT in line_of(screen, "port")
    assert any(line.startswith("  0   34.5") for line in screen)


def test_stm32duinos_codes_are_those_of_its_sensor() -> None:
    watch = Watch("host:1")
    watch.take_devices([device()], 0.0)
    watch.devices[0].take_status(status(format="stm32duino"), 1.0)
    watch.devices[0].take_ranges(ranges([T0], [[0.03, 0.03]], [[4, 99]]), 1.0)
    screen = "\n".join(drawn(watch))
    assert "4 out of bounds" in screen
    assert "99 unknown code" in screen


def test_more_modules_than_lines_say_how_many_are_not_shown() -> None:
    watch = Watch("host:1")
    watch.take_devices([device()], 0.0)
    watch.devices[0].take_status(status(), 1.0)
    watch.devices[0].take_ranges(ranges([T0], [[0.03] * 64]), 1.0)
    screen = drawn(watch)
    more = next(line for line in screen if "more modules" in line)
    shown = sum(bool(re.match(r" [ \d]\d +30\.0 ok", line)) for line in screen)
    assert int(re.findall(r"\d+", more)[0]) + shown == 64
    assert line_of(screen, "frames")


@settings(max_examples=40, deadline=None)
@given(width=st.integers(1, 250), height=st.integers(2, 60), modules=st.integers(0, 64), devices=st.integers(0, 12))
def test_any_terminal_will_do(width: int, height: int, modules: int, devices: int) -> None:
    watch = Watch("127.0.0.1:50053")
    watch.take_failure("No gateway answers.", 9.0, 0.0)
    watch.take_devices([device(f"finger-{k}", problem="It does not work.") for k in range(devices)], 0.0)
    for known in watch.devices:
        known.take_status(status(device(known.name)), 1.0)
        if modules:
            known.take_ranges(ranges([T0], [[0.03] * modules]), 2.0)
    drawn(watch, width, height)


def test_the_log_has_a_line_for_each_device() -> None:
    watch = six_modules()
    watch.devices[0].status.recording.unrecorded = 2
    watch.devices[0].status.recording.problem = "The disk is full."
    (line,) = log_lines(watch, WALL)
    time, _, rest = line.partition(" ")
    assert datetime.fromisoformat(time).timestamp() == WALL
    assert rest == (
        "finger streaming, 30.0 Hz, 34.5 120.3 (7) 70.6 (255) (6) mm, lost 7, refused 5, untimed 0, overrun 0, "
        "clock ±0.18 ms, unrecorded 2; The disk is full."
    )


def test_the_log_says_what_is_wrong() -> None:
    watch = Watch("host:1")
    assert [line.partition(" ")[2] for line in log_lines(watch, WALL)] == ["Connecting to host:1."]
    watch.take_failure("No gateway answers.", 103.5, 100.0)
    assert [line.partition(" ")[2] for line in log_lines(watch, WALL)] == ["No gateway answers."]
    watch.take_devices([], 101.0)
    assert [line.partition(" ")[2] for line in log_lines(watch, WALL)] == ["The gateway at host:1 has no device."]
    watch.take_devices([device("a", pb.DEVICE_STATE_SILENT, problem="Nothing comes."), device("b")], 102.0)
    first, second = (line.partition(" ")[2] for line in log_lines(watch, WALL))
    assert first.startswith("a silent, 0.0 Hz, lost 0")
    assert first.endswith("; Nothing comes.")
    assert second.startswith("b streaming")
