"""What a timed path of the fingertip may be."""

from __future__ import annotations

import numpy as np
import pytest

from pretouch.errors import InvalidInput, Malformed
from pretouch.geometry import Array
from pretouch.trajectory import Trajectory

POSES = np.tile(np.eye(4), (3, 1, 1))
TIMES = np.arange(3.0)


def changed(row: int, column: int, value: float) -> Array:
    poses = POSES.copy()
    poses[1, row, column] = value
    return poses


@pytest.mark.parametrize(
    ("poses", "said"),
    [
        (changed(0, 0, 2.0), r"waypoints\[1\].base_T_tip is not a rigid transform"),
        (changed(2, 2, -1.0), r"waypoints\[1\].base_T_tip is not a rigid transform"),
        (changed(3, 0, 0.1), r"waypoints\[1\].base_T_tip is not a rigid transform"),
        (changed(0, 3, 1e7), r"base_T_tip holds 1e\+07"),
        (changed(0, 0, 1e300), r"base_T_tip holds 1e\+300"),
    ],
)
def test_what_is_no_pose_is_refused(poses: Array, said: str) -> None:
    with pytest.raises(InvalidInput, match=said):
        Trajectory(TIMES, poses)


def test_times_rise_and_are_finite() -> None:
    for times in ((0.0, 1.0, 1.0), (0.0, 2.0, 1.0)):
        with pytest.raises(InvalidInput, match="do not increase"):
            Trajectory(np.array(times), POSES)
    with pytest.raises(InvalidInput, match="limit"):
        Trajectory(np.array([0.0, 1.0, 1e300]), POSES)
    with pytest.raises(Malformed):
        Trajectory(np.array([0.0, 1.0, np.nan]), POSES)
