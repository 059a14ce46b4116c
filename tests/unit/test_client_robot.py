"""The simulated robot keeps clear of the object between scans."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pretouch_simulation.robot import GatewayRobot
from pretouch_simulation.robot_motion import CLEARANCE, TRAVEL_SPEED, motion_around

from pretouch.errors import InvalidInput
from pretouch.geometry import Pose
from pretouch.trajectory import Trajectory

DOWN = np.diag([1.0, -1.0, -1.0])


def path(*points: tuple[float, float, float], turn: float = 0.0) -> Trajectory:
    """A scan past `points` at 5 cm/s, the beam straight down, turned about it by `turn`, rad."""
    rotation = Pose.from_rotation_vector([0, 0, turn], [0, 0, 0]).rotation @ DOWN
    poses = np.stack([Pose.of(rotation, point).matrix for point in points])
    steps = np.linalg.norm(np.diff(np.array(points), axis=0), axis=1) / 0.05
    return Trajectory(np.concatenate([[0.0], np.cumsum(steps)]), poses)


coordinates = st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(0.03, 0.3))
scans = st.builds(
    lambda points, turn: path(*points, turn=turn),
    st.lists(coordinates, min_size=2, max_size=4, unique=True).filter(
        lambda points: np.linalg.norm(np.diff(points, axis=0), axis=1).min() > 1e-2
    ),
    st.floats(-3, 3),
)


@settings(max_examples=40)
@given(scans, scans)
@example(path((0.0, 0.0, 0.1), (0.02, 0.0, 0.1)), path((0.02, 1e-5, 0.1), (0.04, 0.0, 0.1)))
def test_the_tip_lifts_travels_high_and_comes_down_along_the_beam(one: Trajectory, two: Trajectory) -> None:
    first = motion_around(one, None)
    second = motion_around(two, first.path.base_T_tip[-1])
    for scan, motion in ((one, first), (two, second)):
        np.testing.assert_allclose(motion.path.at(motion.start + scan.t), scan.base_T_tip, atol=1e-6)
        top = scan.base_T_tip[:, 2, 3].max() + CLEARANCE
        above, after = motion.path.base_T_tip[motion.path.t < motion.start][-1], motion.path.base_T_tip[-1]
        for pose, waypoint in ((above, scan.base_T_tip[0]), (after, scan.base_T_tip[-1])):
            np.testing.assert_allclose(pose[:2], waypoint[:2], atol=1e-9)
            assert pose[2, 3] >= top - 1e-9
    travel = second.path.at(np.linspace(0, second.start, 50))[:, :3, 3]
    ends = np.stack([one.base_T_tip[-1, :2, 3], two.base_T_tip[0, :2, 3]])
    between = np.linalg.norm(travel[:, None, :2] - ends, axis=2).min(axis=1) > 1e-6
    lowest = max(first.path.base_T_tip[-1, 2, 3], two.base_T_tip[:, 2, 3].max() + CLEARANCE)
    assert (travel[between, 2] >= lowest - 1e-9).all()
    speeds = np.linalg.norm(np.diff(travel, axis=0), axis=1) / (second.start / 49)
    assert speeds.max() <= TRAVEL_SPEED * (1 + 1e-6)


def test_a_faster_pace_keeps_the_path() -> None:
    motion = motion_around(path((0, 0, 0.1), (0.1, 0, 0.1)), None)
    fast = motion.at_pace(4.0)
    assert fast.end - fast.start == pytest.approx((motion.end - motion.start) / 4)
    np.testing.assert_array_equal(fast.path.base_T_tip, motion.path.base_T_tip)


@settings(max_examples=40)
@given(scans, st.floats(0.01, 1.0))
def test_a_motion_that_is_stopped_is_the_same_until_then_and_rises(one: Trajectory, share: float) -> None:
    motion = motion_around(one, None)
    now = share * motion.path.duration
    stopped = motion.stopped(now)
    times = np.linspace(0.0, now, 20)
    np.testing.assert_allclose(stopped.path.at(times), motion.path.at(times), atol=1e-9)
    last, here = stopped.path.base_T_tip[-1], motion.path.at([now])[0]
    np.testing.assert_allclose(last[:2], here[:2], atol=1e-9)
    assert last[2, 3] == pytest.approx(motion.path.base_T_tip[-1, 2, 3])
    assert stopped.start <= stopped.end <= now + 1e-9 or share == 1.0


def test_a_pace_of_nothing_is_refused() -> None:
    class Still:
        def play(self, trajectory: Trajectory, start: float | None = None) -> None: ...

    with pytest.raises(InvalidInput, match="pace"):
        GatewayRobot(Still(), "127.0.0.1:50053", pace=0.0)
