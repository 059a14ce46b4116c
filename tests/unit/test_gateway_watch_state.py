"""What is known of a gateway follows from its messages, and what happened is told once."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from helpers.watched_gateway import device, module, ranges, status
from hypothesis import given
from hypothesis import strategies as st
from pretouch_sensor_gateway.watch.events import KEPT, QUIET, EventLog, Severity
from pretouch_sensor_gateway.watch.state import Watch, WatchedDevice

from pretouch.errors import InvalidInput
from pretouch.v1 import sensor_gateway_pb2 as pb

T0 = 1.7e9


def watch_of(*devices: pb.Device) -> Watch:
    watch = Watch("host:50053")
    watch.take_devices(devices or [device()], 0.0)
    return watch


def happened(watch: Watch) -> list[str]:
    return [f"{event.amount or ''} {event.text}".strip() for event in watch.events.last(KEPT)]


def only(watch: Watch) -> WatchedDevice:
    (known,) = watch.devices
    return known


def test_the_newest_measurement_counts_and_recent_returns_have_a_share() -> None:
    finger = only(watch_of())
    assert math.isnan(finger.returns(0))
    finger.take_ranges(ranges([T0, T0 + 0.03], [[0.03, 0.04], [0.031, 0.2]], [[0, 0], [0, 255]], [[0, 0], [1, 0]]))
    first, second = finger.readings
    assert first == (0.031, 0, pb.RANGE_STATUS_GOOD, 1)
    assert math.isnan(second.range)
    assert (second.code, second.flags) == (255, 0)
    assert (finger.returns(0), finger.returns(1)) == (1.0, 0.5)


def test_before_any_range_comes_the_gateways_last_ones_are_shown() -> None:
    finger = only(watch_of())
    assert finger.readings == []
    finger.take_status(status(modules=[module(range=0.05, status=0), module(range=math.nan, status=7)]), 1.0)
    assert [reading.code for reading in finger.readings] == [0, 7]
    assert finger.readings[0].range == 0.05


def test_a_device_may_change_its_number_of_modules() -> None:
    finger = only(watch_of())
    finger.take_ranges(ranges([T0], [[0.03]]))
    finger.take_ranges(ranges([T0 + 1], [[0.03, 0.04]]))
    assert len(finger.readings) == 2
    assert (finger.returns(0), finger.returns(1)) == (1.0, 1.0)


def test_arrays_that_are_none_are_refused() -> None:
    response = ranges([T0], [[0.03]])
    response.batch.range.shape[0] = 2
    with pytest.raises(InvalidInput, match="range"):
        only(watch_of()).take_ranges(response)


def test_all_that_happens_is_told() -> None:
    watch = watch_of()
    finger = only(watch)
    finger.take_status(status(device(state=pb.DEVICE_STATE_CONNECTING, problem="There is no device."), epoch=0), 1.0)
    finger.take_status(status(device(state=pb.DEVICE_STATE_CONNECTING, problem="It is held."), epoch=0), 2.0)
    unknown = pb.ClockStatus(synchronised=False)
    finger.take_status(status(epoch=1, clock=unknown), 3.0)
    finger.take_status(status(epoch=2, clock=unknown, untimed=5, refused={"checksum": 2}), 4.0)
    seen = {"epoch": 2, "untimed": 5, "refused": {"checksum": 2}, "host_clock_jumps": 1}
    finger.take_status(status(**seen), 5.0)
    recording = pb.RecordingStatus(on=True, path="a.mcap")
    finger.take_status(status(**seen, recording=recording), 6.0)
    recording.problem = "The disk is full."
    finger.take_status(status(**seen, recording=recording), 7.0)
    finger.take_status(status(**seen, recording=pb.RecordingStatus(problem="The disk is full.")), 8.0)
    finger.take_status(status(device(lost_frames=1), **seen, overrun=4), 9.0)
    assert happened(watch) == [
        "connecting: There is no device.",
        "It is held.",
        "streaming",
        "restarted: epoch 1",
        "its clock is not known",
        "restarted: epoch 2",
        "5 given up: their time was not known",
        "2 refused: checksum",
        "1 jumps of the host's clock",
        "its clock is known",
        "recording to a.mcap",
        "recording: The disk is full.",
        "recording stopped",
        "1 lost",
        "4 lost to slow subscribers",
    ]
    assert finger.state_since == 3.0


@given(st.lists(st.tuples(st.floats(0, 30), st.integers(0, 5)), max_size=40))
def test_what_is_lost_is_told_in_full_and_within_ten_seconds_in_one_line(steps: list[tuple[float, int]]) -> None:
    watch = watch_of()
    only(watch).take_status(status(), 0.0)
    at, lost = 0.0, 0
    for step, more in steps:
        at, lost = at + step, lost + more
        only(watch).take_status(status(device(lost_frames=lost)), at)
    told = [event for event in watch.events.last(KEPT) if event.text == "lost"]
    assert sum(event.amount for event in told) == lost
    assert all(later.first - earlier.at > QUIET for earlier, later in pairwise(told))


def test_the_log_keeps_what_happened_last() -> None:
    log = EventLog()
    for k in range(3 * KEPT):
        log.add("a", str(k), Severity.NOTE, float(k))
    assert [event.text for event in log.last(2)] == ["298", "299"]
    assert len(log.last(1000)) == KEPT


def test_a_gateway_that_comes_back_counts_from_the_start_and_its_devices_go_on() -> None:
    watch = watch_of(device("thumb"), device("index"))
    thumb = watch.devices[0]
    thumb.take_status(status(device("thumb"), refused={"checksum": 7}, untimed=9, epoch=4), 1.0)
    assert watch.live(thumb)
    watch.take_failure("No gateway answers.", 5.0, 2.0)
    watch.take_failure("No gateway answers.", 9.0, 5.0)
    assert not watch.live(thumb)
    assert (watch.problem, watch.retry_at, watch.connected, watch.heard) == ("No gateway answers.", 9.0, False, True)
    watch.take_devices([device("index"), device("thumb")], 10.0)
    assert watch.devices[1] is thumb
    thumb.take_status(status(device("thumb"), refused={"checksum": 1}, epoch=1), 11.0)
    before = ["streaming", "No gateway answers.", "the gateway at host:50053 is back"]
    assert happened(watch) == before
    thumb.take_status(status(device("thumb"), refused={"checksum": 2}, epoch=2), 12.0)
    assert happened(watch) == [*before, "restarted: epoch 2", "1 refused: checksum"]


def test_the_selection_goes_round_and_stays_within_the_devices() -> None:
    watch = Watch("host:50053")
    assert watch.selected is None
    watch.take_devices([device("a"), device("b"), device("c")], 0.0)
    names = []
    for _ in range(4):
        watch.select_next()
        names.append(watch.selected and watch.selected.name)
    assert names == ["b", "c", "a", "b"]
    watch.take_devices([device("a")], 1.0)
    assert watch.selected is watch.devices[0]
