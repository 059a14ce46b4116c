"""What the screen and the log say of a gateway."""

from __future__ import annotations

import io
import re
from datetime import datetime

import pytest
from helpers.watched_gateway import PORT, device, module, ranges, status
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_sensor_gateway.watch.log_lines import log_lines
from pretouch_sensor_gateway.watch.state import Watch
from pretouch_sensor_gateway.watch.view import draw
from rich.console import Console

from pretouch.v1 import sensor_gateway_pb2 as pb

T0 = 1.7e9
WALL = 1_763_700_000.0


def drawn(watch: Watch, width: int = 100, height: int = 30, now: float = 100.0, raw: bool = True) -> list[str]:
    """The lines of the screen; none is too wide."""
    console = Console(width=width, height=height, record=True, file=io.StringIO())
    console.print(draw(watch, now, WALL, raw))
    said = console.export_text().split("\n")
    assert max(map(len, said)) <= width
    return [line.rstrip() for line in said]


def line_of(screen: list[str], label: str) -> str:
    """The line that begins with `label`, and those that go on with it."""
    first = next(k for k, line in enumerate(screen) if line.strip().startswith(label))
    last = first + 1
    while screen[last].startswith(" " * 9) and screen[last].strip():
        last += 1
    return " ".join(" ".join(screen[first:last]).split())


def six_modules() -> Watch:
    watch = Watch("127.0.0.1:50053")
    watch.take_devices([device()], 0.0)
    (finger,) = watch.devices
    counts = device(frames=1_235_752, lost_frames=7, bad_frames=5)
    modules = [module(jumps=k) for k in range(6)]
    recording = pb.RecordingStatus(on=True, path="recordings/finger.mcap", bytes=12_345_678)
    finger.take_status(status(counts, refused={"checksum": 3, "length": 2}, modules=modules, recording=recording), 1.0)
    for k in range(300):
        metres = [0.0345, 0.1203, 0.05, 0.05, 0.05, 0.05]
        codes = [0, 0, 7 if k >= 150 else 0, 0, 255, 6]
        flags = [2, 0, 0, 1, 0, 0]
        finger.take_ranges(ranges([T0 + k / 30], [metres], [codes], [flags]))
    return watch


@pytest.mark.parametrize("width", [80, 120])
def test_a_device_in_good_health_is_told_in_full(width: int) -> None:
    screen = drawn(six_modules(), width)
    assert "127.0.0.1:50053" in screen[0]
    assert datetime.fromtimestamp(WALL).strftime("%H:%M:%S") in screen[0]
    assert line_of(screen, "state") == "state ● streaming at 30.0 Hz · for 0:01:39 · epoch 3 · opened 2 times"
    assert PORT in line_of(screen, "port")
    for fact in ("binary", "0102030405060708", "fingertip 1.0", "modules 6", "30 Hz"):
        assert fact in line_of(screen, "device")
    for fact in ("1,235,752 good", "7 lost", "5 refused", "3 checksum", "2 length", "0 untimed", "0 overrun"):
        assert fact in line_of(screen, "frames")
    for fact in ("synchronised", "+12.3 ppm", "0.18 ms", "round trip 0.92 ms"):
        assert fact in line_of(screen, "clock")
    for fact in ("on", "recordings/finger.mcap", "12.3 MB", "0 unrecorded"):
        assert fact in line_of(screen, "record")


def test_each_module_has_its_range_status_bar_and_counts() -> None:
    screen = drawn(six_modules())
    titles = next(k for k, line in enumerate(screen) if line.split()[:2] == ["#", "mm"])
    rows = screen[titles + 1 : titles + 7]
    assert [row.split()[0] for row in rows] == list("012345")
    assert [row.split()[1] for row in rows] == ["34.5", "120.3", "-", "50.0", "-", "-"]
    meant = ["good, warming up", "good", "no target (7)", "good, jump", "no answer (255)", "rejected (6)"]
    for row, words in zip(rows, meant, strict=True):
        assert f" {words} " in row
    lengths = [row.count("█") for row in rows]
    assert lengths[0] < lengths[3] < lengths[1]
    assert lengths[2] == 0
    assert [row.split(" %")[0].split()[-1] for row in rows] == ["100", "100", "50", "100", "0", "0"]
    assert [row.split()[-1] for row in rows] == list("012345")


def test_a_problem_is_told_where_the_state_is() -> None:
    watch = Watch("host:1")
    watch.take_devices([device()], 0.0)
    problem = "There is no device at /dev/ttyUSB0: it is not plugged in, or it has another name."
    unknown = pb.ClockStatus(synchronised=False)
    of = device(state=pb.DEVICE_STATE_CONNECTING, problem=problem)
    watch.devices[0].take_status(
        status(of, format="", identity=None, clock=unknown, host_clock_jumps=1, untimed=3, rate=0.0), 50.0
    )
    screen = drawn(watch)
    assert line_of(screen, "state").startswith("state ● connecting at 0.0 Hz · for 0:00:50")
    assert line_of(screen, "problem") == f"problem {problem}"
    assert line_of(screen, "device") == "device format not recognised yet"
    assert "not synchronised" in line_of(screen, "clock")
    assert "1 jumps of the host's clock" in line_of(screen, "clock")
    assert "3 untimed" in line_of(screen, "frames")
    assert line_of(screen, "record") == "record off"


def test_what_the_device_sends_is_shown_on_demand() -> None:
    watch = Watch("host:1")
    watch.take_devices([device()], 0.0)
    watch.devices[0].take_status(status(unit="mm", recent_lines=["'rst:0x10 (RTCWDT)'", "'23 [mm]'"]), 1.0)
    screen = "\n".join(drawn(watch))
    assert "'rst:0x10 (RTCWDT)'" in screen
    assert "'23 [mm]'" in screen
    assert "in mm" in screen
    assert "RTCWDT" not in "\n".join(drawn(watch, raw=False))


def test_events_come_with_their_times_and_the_last_ones_stay() -> None:
    watch = six_modules()
    for k in range(12):
        watch.devices[0].take_status(status(epoch=4 + k), 91.0 + k / 2)
    watch.devices[0].take_status(status(device(lost_frames=3), epoch=15), 97.0)
    watch.devices[0].take_status(status(device(lost_frames=7), epoch=15), 99.0)
    said = [line for line in drawn(watch) if re.match(r"\d\d:\d\d:\d\d ", line)]
    assert len(said) == 8
    assert said[-1].split() == [datetime.fromtimestamp(WALL - 1.0).strftime("%H:%M:%S"), "7", "lost"]
    assert said[-2].endswith("restarted: epoch 15")


def test_devices_are_told_apart_and_the_one_that_is_looked_at_is_shown() -> None:
    watch = Watch("host:1")
    watch.take_devices([device("thumb"), device("index")], 0.0)
    for known, port in zip(watch.devices, ("/dev/a", "/dev/b"), strict=True):
        of = device(known.name)
        of.port = port
        known.take_status(status(of), 1.0)
    assert "/dev/a" in line_of(drawn(watch), "port")
    watch.select_next()
    screen = drawn(watch)
    assert "/dev/b" in line_of(screen, "port")
    assert "thumb ●  index ●" in screen[0]
    assert "index: streaming" in "\n".join(screen)
    assert "Tab" in screen[0]


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
    assert any(line.split()[:2] == ["0", "34.5"] for line in screen)


@settings(max_examples=40, deadline=None)
@given(width=st.integers(1, 250), height=st.integers(2, 60), modules=st.integers(0, 64), devices=st.integers(0, 12))
def test_any_terminal_will_do(width: int, height: int, modules: int, devices: int) -> None:
    watch = Watch("127.0.0.1:50053")
    watch.take_failure("No gateway answers.", 9.0, 0.0)
    watch.take_devices([device(f"finger-{k}", problem="It does not work.") for k in range(devices)], 0.0)
    for known in watch.devices:
        known.take_status(status(device(known.name)), 1.0)
        if modules:
            known.take_ranges(ranges([T0], [[0.03] * modules]))
    drawn(watch, width, height)


def test_the_log_has_a_line_for_each_device() -> None:
    watch = six_modules()
    watch.devices[0].status.recording.unrecorded = 2
    watch.devices[0].status.recording.problem = "The disk is full."
    (line,) = log_lines(watch, WALL)
    time, _, rest = line.partition(" ")
    assert datetime.fromisoformat(time).timestamp() == WALL
    assert rest == (
        "finger streaming, 30.0 Hz, 34.5 120.3 (7) 50.0 (255) (6) mm, lost 7, refused 5, untimed 0, overrun 0, "
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
