"""Poses on a robot's own clock: their offset is bounded by messages, and clocks that differ unsaid are noticed."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import AsyncIterator, Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_sensor_gateway.calibration.model import Calibration
from pretouch_sensor_gateway.clock.clock_offset import ClockOffset
from pretouch_sensor_gateway.device import Device
from pretouch_sensor_gateway.live_pose_check import MAX_DIFFERENCE, STAY
from pretouch_sensor_gateway.point_stream import FusedBatch, PointStream
from pretouch_sensor_gateway.range_batch import RangeBatch
from pretouch_sensor_gateway.source import DeviceState, SourceStatus
from pretouch_sensor_gateway.tip_pose_receiver import TipPoseReceiver

from pretouch.errors import InvalidInput
from pretouch.geometry import Pose
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.wire.common import pose_to_proto

T0 = 1.7e9
offsets = st.floats(-1e5, 1e5)
delays = st.floats(0, 0.2)


class StoppedClock:
    """A source that measures nothing, whose clock the test moves."""

    def __init__(self) -> None:
        self.at = T0

    async def run(self) -> None:
        raise NotImplementedError

    def now(self) -> float:
        return self.at

    def status(self) -> SourceStatus:
        return SourceStatus(DeviceState.STREAMING, refused=Counter())

    def calibrate(self, calibration: Calibration | None) -> None:
        raise NotImplementedError


def device() -> tuple[Device, StoppedClock]:
    finger = Device("finger", "/dev/none", [Pose.identity()], None, None)
    finger.source = clock = StoppedClock()
    return finger, clock


def poses(*times: float, **members: object) -> pb.StreamPointsRequest:
    """A message with poses of a tip that moves along x at 5 cm/s by the gateway's clock, if that is the robot's."""
    tips = [pb.TipPose(t=t, base_t_tip=pose_to_proto(Pose.of(np.eye(3), (0.05 * (t - T0), 0, 0)))) for t in times]
    return pb.StreamPointsRequest(tip_poses=tips, **members)  # type: ignore[arg-type]


def batch(*times: float) -> RangeBatch:
    count = len(times)
    codes = np.zeros((count, 1), dtype=np.uint8)
    ranges, std = np.full((count, 1), 0.03), np.full((count, 1), 0.001, dtype=np.float32)
    return RangeBatch(np.array(times), 1e-4, np.arange(count, dtype=np.uint32), 0, ranges, ranges, codes, codes, 0, std)


@given(offsets, st.lists(st.tuples(delays, delays, delays), min_size=1, max_size=40))
def test_the_offset_is_bounded_by_the_shortest_way_there_and_back(
    offset: float, exchanges: list[tuple[float, float, float]]
) -> None:
    estimate, sent = ClockOffset(), T0
    for there, held, back in exchanges:
        received = sent + there + offset
        assert estimate.add(sent, received, received + held, sent + there + held + back + 1e-6)
        sent += 1.0
    least = min(there for there, _, _ in exchanges[-32:]) + min(back for _, _, back in exchanges[-32:]) + 1e-6
    assert abs(estimate.value - offset) <= least / 2 + 1e-6
    assert estimate.std == pytest.approx(least / 12**0.5, abs=1e-6)


@given(offsets, st.floats(1.0, 1e4))
def test_a_clock_that_was_set_is_followed_at_once(offset: float, step: float) -> None:
    estimate = ClockOffset()
    for offset_now in (offset, offset + step):
        for k in range(5):
            assert estimate.add(T0 + k, T0 + k + 0.001 + offset_now, T0 + k + 0.002 + offset_now, T0 + k + 0.003)
        assert estimate.value == pytest.approx(offset_now, abs=1e-5)


@pytest.mark.parametrize("held", [-0.1, float("nan"), float("inf")])
def test_an_impossible_exchange_changes_nothing(held: float) -> None:
    estimate = ClockOffset()
    assert not estimate.add(T0, 5.0, 5.0 + (held if held != -0.1 else 0.1), T0 + 0.05)
    assert not estimate.known


@given(st.floats(-100.0, 100.0), st.permutations(range(12)), st.integers(1, 12))
def test_poses_that_come_too_late_are_dropped_and_counted(offset: float, order: list[int], per_message: int) -> None:
    finger, _ = device()
    times = [T0 + 0.01 * k for k in order]
    messages = [[t + offset for t in times[start : start + per_message]] for start in range(0, len(times), per_message)]
    receiver = TipPoseReceiver(finger, poses(clock_offset=offset))
    for message in messages:
        receiver.add(poses(*message))
    kept = [k for n, k in enumerate(order) if k == max(order[: n + 1])]
    assert receiver.out_of_order == len(order) - len(kept)
    assert receiver.path.end == pytest.approx(T0 + 0.11, abs=1e-6)
    assert receiver.clock_offset == offset


def stream_live(difference: float, seconds: float, stated: float | None, rate: float = 50.0) -> TipPoseReceiver:
    """A robot whose clock is off by `difference` s sends poses as it moves, of the last and this period."""
    finger, clock = device()
    receiver = TipPoseReceiver(finger, poses() if stated is None else poses(clock_offset=stated))
    try:
        for k in range(round(seconds * rate)):
            clock.at = T0 + k / rate
            receiver.add(poses(clock.at + difference - 0.5 / rate, clock.at + difference))
    except InvalidInput:
        assert not finger.history.between(T0 - 100, T0 + 100)[1]  # forgotten: no GetSamples may use them
        raise
    assert receiver.path.end == pytest.approx(clock.at + difference - (stated or 0.0))
    return receiver


@settings(max_examples=25, deadline=None)
@given(st.floats(MAX_DIFFERENCE + 0.02, 300.0), st.sampled_from([-1, 1]))
def test_a_clock_that_differs_unsaid_is_refused_before_any_point_can_come_of_it(size: float, sign: int) -> None:
    difference = sign * size
    stream_live(difference, STAY - 0.05, None)
    with pytest.raises(InvalidInput, match="ahead of" if sign > 0 else "behind") as caught:
        stream_live(difference, STAY + 0.1, None)
    assert f"about {difference:.3f} s" in caught.value.remedy
    stream_live(difference, STAY + 0.1, stated=difference)


@settings(max_examples=25, deadline=None)
@given(st.floats(-MAX_DIFFERENCE + 0.02, MAX_DIFFERENCE - 0.02))
def test_a_robot_that_is_a_little_late_or_early_is_heard(difference: float) -> None:
    stream_live(difference, 3 * STAY, None)


@settings(max_examples=25, deadline=None)
@given(st.floats(0.0, 60.0), st.integers(1, 8), st.floats(0.0, 0.05))
def test_a_motion_planned_ahead_and_sent_at_once_is_no_live_one(ahead: float, messages: int, pause: float) -> None:
    finger, clock = device()
    receiver = TipPoseReceiver(finger, poses())
    for k in range(messages):
        clock.at += pause
        receiver.add(poses(*(T0 + ahead + 2.0 * k + 0.1 * np.arange(20))))
    assert receiver.out_of_order == 0


def test_what_a_first_message_cannot_mean() -> None:
    finger, _ = device()
    with pytest.raises(InvalidInput, match="clock_offset"):
        TipPoseReceiver(finger, poses(clock_offset=1.0, robot_clock=pb.RobotClock(now=1.0)))
    with pytest.raises(InvalidInput, match="finite"):
        TipPoseReceiver(finger, poses(clock_offset=float("nan")))
    receiver = TipPoseReceiver(finger, poses(robot_clock=pb.RobotClock(now=1.0)))
    with pytest.raises(InvalidInput, match="before the robot's clock is known"):
        receiver.add(poses(1.0, robot_clock=pb.RobotClock(now=1.0)))
    with pytest.raises(InvalidInput, match="no possible order"):
        receiver.add(poses(robot_clock=pb.RobotClock(now=1.0, gateway_now=T0 + 5.0, received=1.0)))
    with pytest.raises(InvalidInput, match="the first did not"):
        TipPoseReceiver(finger, poses()).add(poses(robot_clock=pb.RobotClock(now=1.0)))


async def fuse(first: pb.StreamPointsRequest, later: Sequence[pb.StreamPointsRequest]) -> list[FusedBatch]:
    """What a call is answered whose finger measures from T0 to T0 + 1 s."""

    async def requests() -> AsyncIterator[pb.StreamPointsRequest]:
        for message in later:
            yield message

    finger, clock = device()
    with finger.subscribe() as subscription:
        finger.deliver(batch(*(T0 + np.arange(0.05, 1.2, 0.1))))
        clock.at = T0 + 1.2
        stream = PointStream(finger, subscription, first, requests())
        return [answer async for answer in stream.fuse(asyncio.Event())]


def tips(clock: float) -> list[pb.TipPose]:
    times = T0 + np.arange(0.0, 1.01, 0.1)
    return [
        pb.TipPose(t=t + clock, base_t_tip=pose_to_proto(Pose.of(np.eye(3), (0.05 * (t - T0), 0, 0)))) for t in times
    ]


@settings(max_examples=20, deadline=None)
@given(offsets)
def test_points_are_where_the_tip_was_whatever_the_robots_clock_shows(offset: float) -> None:
    (plain,) = asyncio.run(fuse(pb.StreamPointsRequest(tip_poses=tips(0.0)), []))
    (stated,) = asyncio.run(fuse(pb.StreamPointsRequest(tip_poses=tips(offset), clock_offset=offset), []))
    clock = [
        pb.RobotClock(now=T0 + 1.2 + offset),
        pb.RobotClock(now=T0 + 1.199 + offset, gateway_now=T0 + 1.198, received=T0 + 1.1985 + offset),
    ]
    first = pb.StreamPointsRequest(robot_clock=clock[0])
    pinged = asyncio.run(fuse(first, [pb.StreamPointsRequest(tip_poses=tips(offset), robot_clock=clock[1])]))[-1]
    assert len(plain.fused.samples) == len(stated.fused.samples) == 10
    np.testing.assert_allclose(stated.fused.points, plain.fused.points, atol=1e-6)
    np.testing.assert_allclose(pinged.fused.points, plain.fused.points, atol=0.05 * 0.0015 / 2 + 1e-6)
    assert pinged.clock_offset == pytest.approx(offset, abs=0.0015 / 2 + 1e-6)
    assert pinged.clock_offset_std == pytest.approx(0.0015 / 12**0.5, rel=1e-2)
    moved = np.sqrt(pinged.fused.std**2 - plain.fused.std**2)
    np.testing.assert_allclose(moved, 0.05 * pinged.clock_offset_std, rtol=0.05)


def test_a_message_that_only_tells_the_robots_clock_is_answered_at_once() -> None:
    answers = asyncio.run(fuse(pb.StreamPointsRequest(robot_clock=pb.RobotClock(now=3.0)), []))
    assert [(len(answer.fused.samples), answer.now) for answer in answers] == [(0, T0 + 1.2)]
