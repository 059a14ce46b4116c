"""The simulated finger measures where the robot will be, when it says it does."""

from __future__ import annotations

import json
import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from pretouch_sensor_gateway.wire_formats.binary import FrameDecoder, encode
from pretouch_sensor_gateway.wire_formats.messages import Identify, Ping
from pretouch_sensor_gateway.wire_formats.parser import Identity, Measurement, PingReply
from pretouch_simulation.finger_process import MAX_DRIFT, NO_TARGET, Finger, motion_from

from pretouch.errors import PretouchError
from pretouch.geometry import Array, Pose
from pretouch.trajectory import Trajectory

T0 = 1.7e9


def height(poses: Array) -> tuple[Array, NDArray[np.int64]]:
    """A world in which the range is the tip's height."""
    return poses[:, 2, 3], np.zeros(len(poses), dtype=np.int64)


def rising(start: float, end: float, speed: float = 0.1, base: float = 0.0) -> Trajectory:
    t = np.array([start, end])
    return Trajectory(t, np.stack([Pose.of(np.eye(3), [0, 0, base + speed * (s - start)]).matrix for s in t]))


def ranges_of(frames: list[bytes]) -> list[Measurement]:
    return [message for message in FrameDecoder().feed(b"".join(frames)) if isinstance(message, Measurement)]


def finger(rate: float = 100.0, measure: Callable[[Array], tuple[Array, NDArray[np.int64]]] = height) -> Finger:
    return Finger(measure, rate, 1, T0)


@given(st.lists(st.floats(0.001, 0.3), min_size=1, max_size=20), st.booleans())
@settings(max_examples=30)
def test_each_sample_is_of_its_own_moment_however_it_is_waited_for(waits: list[float], ahead: bool) -> None:
    device = finger()
    device.announce(rising(T0 + 0.1055, T0 + 0.9))
    now, frames = T0, []
    for wait in waits:
        while ahead and not device.idle:
            device.measure_ahead()
        now += wait
        frames += device.take_due(now)
    for k, message in enumerate(ranges_of(frames)):
        t = k / 100.0
        assert message.sequence == k
        if 0.1055 <= t <= 0.9:
            assert message.status == (0,)
            assert message.ranges[0] == pytest.approx(0.1 * (t - 0.1055), abs=0.6e-4)
        else:
            assert message.status == (NO_TARGET,)
            assert math.isnan(message.ranges[0])


def test_the_trajectory_announced_last_counts() -> None:
    device = finger()
    device.announce(rising(T0, T0 + 1.0, speed=0.0, base=0.1))
    device.announce(rising(T0 + 0.205, T0 + 0.505, speed=0.0, base=0.2))
    device.measure_ahead()
    seen = [message.ranges[0] for message in ranges_of(device.take_due(T0 + 1.0))]
    assert np.round(seen, 4).tolist() == [0.1] * 21 + [0.2] * 30 + [0.1] * 50


def test_a_late_announcement_changes_nothing_that_was_sent() -> None:
    device = finger()
    before = ranges_of(device.take_due(T0 + 0.5))
    device.announce(rising(T0, T0 + 1.0))
    after = ranges_of(device.take_due(T0 + 1.0))
    assert {message.status for message in before} == {(NO_TARGET,)}
    assert {message.status for message in after} == {(0,)}
    assert after[0].ranges[0] == pytest.approx(0.051, abs=1e-4)


def test_its_clock_starts_anywhere_drifts_and_answers_pings() -> None:
    device = finger()
    device.take_due(T0)
    (reply,) = FrameDecoder().feed(b"".join(device.reply_to(b"noise\x00" + encode(Ping(9)), T0 + 1000.0)))
    assert isinstance(reply, PingReply)
    assert reply.sequence == 9
    (identity,) = FrameDecoder().feed(b"".join(device.reply_to(encode(Identify()), T0)))
    assert isinstance(identity, Identity)
    assert (identity.boot, identity.modules, identity.period) == (reply.boot, 1, pytest.approx(0.01))
    elapsed = (reply.micros - device.micros(T0)) % 2**32
    assert 0 < abs(elapsed - 1e9) <= MAX_DRIFT * 1e9 + 1
    assert device.micros(T0) != 0


def test_lines_that_announce_nothing_readable_are_refused() -> None:
    pose = np.eye(4).ravel().tolist()
    good = motion_from(json.dumps({"start": T0, "t": [0, 1], "base_T_tip": [pose, pose]}).encode())
    assert good.t.tolist() == [T0, T0 + 1]
    for line in (
        b"{",
        b"[]",
        b"{}",
        b'{"start": 0, "t": [0], "base_T_tip": [[1]]}',
        b'{"start": 0, "t": [], "base_T_tip": []}',
    ):
        with pytest.raises((ValueError, KeyError, TypeError, PretouchError)):
            motion_from(line)
