"""What a listener gets, and what it is told that it did not get."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_sensor_gateway.batch import Batch
from pretouch_sensor_gateway.jumps import STEP, Jumps
from pretouch_sensor_gateway.subscription import QUEUE_FRAMES, Delivery, Subscription
from pretouch_sensor_gateway.tally import Tally
from pretouch_sensor_gateway.wire import batch_from_proto, batch_to_proto


def batch(first: int, count: int = 1, lost: int = 0, metres: float = 0.03) -> Batch:
    row, codes = np.full((count, 2), metres), np.zeros((count, 2), dtype=np.uint8)
    sequence = np.arange(first, first + count, dtype=np.uint32)
    return Batch(np.arange(count) * 1.0, 0.001, sequence, 0, row, row, codes, codes, lost)


@given(st.lists(st.tuples(st.integers(1, 300), st.integers(0, 5), st.booleans()), max_size=60))
@settings(max_examples=50)
def test_every_frame_is_taken_lost_or_overrun_whenever_the_listener_takes(steps: list[tuple[int, int, bool]]) -> None:
    subscription = Subscription()
    offered = got = told = 0
    for count, lost, takes in steps:
        subscription.offer(Delivery(batch(offered + lost, count, lost)))
        offered += count + lost
        if takes:
            deliveries, overrun = subscription.take()
            got += sum(len(delivery.batch) + delivery.batch.lost for delivery in deliveries)
            told += overrun
            assert sum(len(delivery.batch) for delivery in deliveries) <= max(QUEUE_FRAMES, count)
            assert got + told == offered
    assert subscription.overrun >= told


def test_the_oldest_go_first() -> None:
    subscription = Subscription()
    for k in range(QUEUE_FRAMES + 10):
        subscription.offer(Delivery(batch(k)))
    deliveries, overrun = subscription.take()
    assert overrun == 10
    assert [int(delivery.batch.sequence[0]) for delivery in deliveries] == list(range(10, QUEUE_FRAMES + 10))
    assert subscription.take() == ([], 0)


def test_a_batch_is_packed_once_and_comes_back_the_same() -> None:
    original = batch(7, 3, 2, metres=np.nan)
    delivery = Delivery(original)
    assert delivery.message is delivery.message
    again = batch_from_proto(delivery.message)
    for name in ("t", "sequence", "range", "raw", "status", "flags"):
        np.testing.assert_array_equal(getattr(again, name), getattr(original, name))
        assert getattr(again, name).dtype == getattr(original, name).dtype
    assert (again.time_std, again.epoch, again.lost) == (original.time_std, original.epoch, original.lost)
    assert batch_to_proto(again) == delivery.message


@given(st.lists(st.one_of(st.none(), st.floats(0.01, 0.2)), max_size=50))
def test_a_jump_is_far_from_what_was_believed_and_two_agreeing_ranges_are_believed(values: list[float | None]) -> None:
    jumps = Jumps()
    believed: float | None = None
    before: float | None = None  # the last range, believed or not
    for value in values:
        metres = np.array([np.nan if value is None else value])
        flagged = bool(jumps.judge(metres, np.array([7 if value is None else 0], dtype=np.uint8))[0])
        if value is None:
            assert not flagged
            continue
        near_believed = believed is None or abs(value - believed) <= STEP
        near_before = before is not None and abs(value - before) <= STEP
        assert flagged == (not near_believed and not near_before)
        if not flagged:
            believed = value
        before = value


def test_the_tally_counts_and_tells_the_rate_of_the_last_seconds() -> None:
    tally = Tally()
    for k in range(300):
        tally.add(batch(k), 100.0 + k / 30)
    assert [module.measurements for module in tally.modules] == [300, 300]
    assert abs(tally.rate(110.0) - 30) < 1
    assert tally.rate(120.0) == 0
