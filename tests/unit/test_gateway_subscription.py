"""What a listener gets, and what it is told that it did not get."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_sensor_gateway.device_statistics import DeviceStatistics
from pretouch_sensor_gateway.jump_detector import SIGMAS, JumpDetector
from pretouch_sensor_gateway.range_batch import RangeBatch
from pretouch_sensor_gateway.subscription_queue import QUEUE_MEASUREMENTS, SubscriptionQueue


def batch(first: int, count: int = 1, lost: int = 0, metres: float = 0.03) -> RangeBatch:
    row, codes = np.full((count, 2), metres), np.zeros((count, 2), dtype=np.uint8)
    sequence = np.arange(first, first + count, dtype=np.uint32)
    return RangeBatch(np.arange(count) * 1.0, 0.001, sequence, 0, row, row, codes, codes, lost, row.astype(np.float32))


@given(st.lists(st.tuples(st.integers(1, 300), st.integers(0, 5), st.booleans()), max_size=60))
@settings(max_examples=50)
def test_every_frame_is_taken_lost_or_overrun_whenever_the_listener_takes(steps: list[tuple[int, int, bool]]) -> None:
    subscription = SubscriptionQueue()
    offered = got = told = 0
    for count, lost, takes in steps:
        subscription.put(batch(offered + lost, count, lost))
        offered += count + lost
        if takes:
            batches, overrun = subscription.take()
            got += sum(len(taken) + taken.lost for taken in batches)
            told += overrun
            assert sum(len(taken) for taken in batches) <= max(QUEUE_MEASUREMENTS, count)
            assert got + told == offered
    assert subscription.overrun >= told


def test_the_oldest_go_first() -> None:
    subscription = SubscriptionQueue()
    for k in range(QUEUE_MEASUREMENTS + 10):
        subscription.put(batch(k))
    batches, overrun = subscription.take()
    assert overrun == 10
    assert [int(taken.sequence[0]) for taken in batches] == list(range(10, QUEUE_MEASUREMENTS + 10))
    assert subscription.take() == ([], 0)


def test_a_batch_is_packed_once_and_comes_back_the_same() -> None:
    original = batch(7, 3, 2, metres=np.nan)
    assert original.message is original.message
    again = RangeBatch.from_message(original.message)
    assert again.message is original.message
    for name in ("t", "sequence", "range", "raw", "status", "flags"):
        np.testing.assert_array_equal(getattr(again, name), getattr(original, name))
        assert getattr(again, name).dtype == getattr(original, name).dtype
    assert (again.time_std, again.epoch, again.lost) == (original.time_std, original.epoch, original.lost)
    assert replace(again).message == original.message


@given(st.lists(st.one_of(st.none(), st.floats(0.01, 0.2)), max_size=50))
def test_a_jump_is_far_from_what_was_believed_and_two_agreeing_ranges_are_believed(values: list[float | None]) -> None:
    jumps, std = JumpDetector(), 0.0015
    believed: float | None = None
    before: float | None = None  # the last range, believed or not
    for value in values:
        (flagged,) = jumps.detect(0.0, [math.nan if value is None else value], [std])
        if value is None:
            assert not flagged
            continue
        near_believed = believed is None or abs(value - believed) <= SIGMAS * std
        near_before = before is not None and abs(value - before) <= SIGMAS * std
        assert flagged == (not near_believed and not near_before)
        if not flagged:
            believed = value
        before = value


def test_the_statistics_count_and_tell_the_rate_of_the_last_seconds() -> None:
    statistics = DeviceStatistics()
    for k in range(300):
        statistics.add(batch(k), 100.0 + k / 30)
    assert [module.measurements for module in statistics.modules] == [300, 300]
    assert abs(statistics.rate(110.0) - 30) < 1
    assert statistics.rate(120.0) == 0
