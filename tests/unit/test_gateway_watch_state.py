"""What is known of a gateway follows from its messages, and what happened is told once."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from helpers.watched_gateway import device, module, ranges, status
from hypothesis import given
from hypothesis import strategies as st
from pretouch_sensor_gateway.watch.events import KEPT, QUIET, EventLog, Severity
from pretouch_sensor_gateway.watch.keys import Key, parse_keys
from pretouch_sensor_gateway.watch.state import Watch, WatchedDevice

from pretouch.errors import InvalidInput
from pretouch.v1 import sensor_gateway_pb2 as pb

T0 = 1.7e9


def watch_of(*devices: pb.Device) -> Watch:
    watch = Watch("host:50053")
    watch.take_devices(devices or [device()], 0.0)
    return watch


def happened(watch: Watch) -> list[str]:
    return [event.text for event in watch.events.last(KEPT)]


def only(watch: Watch) -> WatchedDevice:
    (known,) = watch.devices
    return known


def test_the_newest_measurement_counts() -> None:
    finger = only(watch_of())
    finger.take_ranges(ranges([T0, T0 + 0.03], [[0.03, 0.04], [0.031, 0.2]], [[0, 0], [0, 255]], [[0, 0], [1, 0]]), 1.0)
    first, second = finger.readings
    assert (first.range, first.code, first.flags) == (0.031, 0, 1)
    assert math.isnan(second.range)
    assert (second.code, second.flags) == (255, 0)
    assert finger.gateway_time(1.5) == T0 + 0.53


def test_before_any_range_comes_the_gateways_last_ones_are_shown() -> None:
    finger = only(watch_of())
    assert finger.readings == []
    finger.take_status(status(modules=[module(range=0.05, status=0), module(range=math.nan, status=7)]), 1.0)
    assert [reading.code for reading in finger.readings] == [0, 7]
    assert finger.readings[0].range == 0.05


def test_a_device_with_another_number_of_modules_begins_a_new_trace() -> None:
    finger = only(watch_of())
    finger.take_ranges(ranges([T0], [[0.03]]), 1.0)
    finger.take_ranges(ranges([T0 + 1], [[0.03, 0.04]]), 2.0)
    assert len(finger.readings) == finger.trace.modules == 2


def test_arrays_that_are_none_are_refused() -> None:
    response = ranges([T0], [[0.03]])
    response.batch.range.shape[0] = 2
    with pytest.raises(InvalidInput, match="range"):
        only(watch_of()).take_ranges(response, 1.0)


def test_all_that_happens_is_told() -> None:
    watch = watch_of()
    finger = only(watch)
    finger.take_status(status(device(state=pb.DEVICE_STATE_CONNECTING, problem="There is no device."), epoch=0), 1.0)
    finger.take_status(status(device(state=pb.DEVICE_STATE_CONNECTING, problem="It is held."), epoch=0), 2.0)
    unknown = pb.ClockStatus(synchronised=False)
    finger.take_status(status(epoch=1, clock=unknown), 3.0)
    finger.take_status(status(epoch=2, clock=unknown, untimed=5, refused={"checksum": 2}), 4.0)
    finger.take_status(status(epoch=2, untimed=5, refused={"checksum": 2}, host_clock_jumps=1), 5.0)
    recording = pb.RecordingStatus(on=True, path="a.mcap")
    seen = {"epoch": 2, "untimed": 5, "refused": {"checksum": 2}, "host_clock_jumps": 1}
    finger.take_status(status(**seen, recording=recording), 6.0)
    recording.problem = "The disk is full."
    finger.take_status(status(**seen, recording=recording), 7.0)
    finger.take_status(status(**seen, recording=pb.RecordingStatus(problem="The disk is full.")), 8.0)
    finger.take_ranges(ranges([T0], [[0.03]], epoch=2, lost=1), 9.0)
    finger.take_ranges(ranges([T0], [[0.03]], epoch=3, overrun=4), 10.0)
    assert happened(watch) == [
        "connecting: There is no device.",
        "It is held.",
        "streaming",
        "restarted: epoch 1",
        "its clock is not known",
        "restarted: epoch 2",
        "2 frames refused: checksum",
        "5 frames given up, their time was not known",
        "its clock is known",
        "the clock of the gateway's host jumped",
        "recording to a.mcap",
        "recording: The disk is full.",
        "recording stopped",
        "1 frame lost",
        "4 frames lost to this view, which read too slowly",
        "restarted: epoch 3",
    ]
    assert finger.state_since == 3.0


@given(
    messages=st.lists(
        st.tuples(st.floats(0, 30), st.integers(0, 5), st.integers(0, 3), st.booleans(), st.integers(0, 2)), max_size=40
    )
)
def test_gaps_and_starts_are_told_in_full_whatever_the_order(
    messages: list[tuple[float, int, int, bool, int]],
) -> None:
    watch = watch_of()
    finger = only(watch)
    at, highest, starts = 0.0, None, 0
    for step, lost, epoch, by_status, frames in messages:
        at += step
        if by_status:
            finger.take_status(status(epoch=epoch), at)
        else:
            t = [T0 + at + 0.01 * k for k in range(frames)]
            finger.take_ranges(ranges(t, [[0.03]] * frames if frames else [[]], epoch=epoch, lost=lost), at)
        starts += highest is not None and epoch > highest
        highest = epoch if highest is None else max(highest, epoch)
    events = watch.events.last(KEPT)
    told = [event for event in events if "lost" in event.text]
    assert sum(event.amount for event in told) == sum(lost for _, lost, _, by_status, _ in messages if not by_status)
    assert all(later.first - earlier.at > QUIET for earlier, later in pairwise(told))
    assert sum("restarted" in event.text for event in events) == starts
    assert [event.at for event in events] == sorted(event.at for event in events)


def test_gaps_in_a_row_are_one_event_and_say_how_many() -> None:
    watch = watch_of()
    for k in range(1000):
        only(watch).take_ranges(ranges([T0 + k], [[0.03]], lost=2), k + 100.0)
    (event,) = watch.events.last(KEPT)
    assert event.text == "2,000 frames lost in 1000 gaps"
    assert (event.first, event.at, event.times) == (100.0, 1099.0, 1000)


def test_the_log_keeps_what_happened_last() -> None:
    log = EventLog()
    for k in range(3 * KEPT):
        log.add("a", str(k), Severity.NOTE, float(k))
    assert [event.text for event in log.last(2)] == ["298", "299"]
    assert log.last(0) == []
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
    assert happened(watch) == ["streaming", "No gateway answers.", "the gateway at host:50053 is back"]
    thumb.take_status(status(device("thumb"), refused={"checksum": 2}, epoch=2), 12.0)
    assert happened(watch)[3:] == ["restarted: epoch 2", "1 frame refused: checksum"]


def test_the_selection_goes_round_and_stays_within_the_devices() -> None:
    watch = Watch("host:50053")
    watch.step(1)
    assert watch.selected is None
    watch.take_devices([device("a"), device("b"), device("c")], 0.0)
    names = []
    for key in (1, 1, 1, -1):
        watch.step(key)
        names.append(watch.selected and watch.selected.name)
    assert names == ["b", "c", "a", "c"]
    watch.select(7)
    assert watch.selected is watch.devices[2]
    watch.take_devices([device("a")], 1.0)
    assert watch.selected is watch.devices[0]


@pytest.mark.parametrize(
    ("typed", "keys"),
    [
        (b"q", [Key.QUIT]),
        (b"\t\x1b[C\x1bOB", [Key.NEXT] * 3),
        (b"\x1b[Z\x1b[D\x1b[A", [Key.PREVIOUS] * 3),
        (b"13x0", [1, 3]),
        (b"\x1b[1;5C\x1b[200~\x1b", []),
        ("éq".encode(), [Key.QUIT]),
    ],
)
def test_keys_are_read_from_what_a_terminal_sends(typed: bytes, keys: list[Key | int]) -> None:
    assert parse_keys(typed) == keys
