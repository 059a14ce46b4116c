"""How the simulated robot moves its fingertip: over the object at a safe height, down, along the scan, and up again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pretouch.geometry import Array, vector_from_rotation
from pretouch.trajectory import Trajectory

CLEARANCE = 0.15
"""m above a scan's highest waypoint, where the tip travels between scans."""
TRAVEL_SPEED = 0.25
"""m/s away from the object."""
PIECE = 0.25
"""s between the pieces in which a robot tells its samples."""
_TURN_SPEED = 1.0  # rad/s
_SHORTEST = 1e-3  # s, of a leg


@dataclass(frozen=True, eq=False)
class Motion:
    """A whole motion around one scan.

    Attributes:
        path: the tip in base, its time from 0 s.
        start, end: s, when the scan itself starts and ends.
    """

    path: Trajectory
    start: float
    end: float

    def at_pace(self, pace: float) -> Motion:
        """The same motion, `pace` times as fast."""
        return Motion(Trajectory(self.path.t / pace, self.path.base_T_tip), self.start / pace, self.end / pace)

    def stopped(self, t: float) -> Motion:
        """The same motion, but from its time `t`, s, on up against the beam, as high as it would have ended."""
        t = min(max(t, self.path.t[0]), self.path.t[-1])
        before = self.path.t < t
        (here,) = self.path.at([t])
        up = -here[:3, 2]
        times, poses = [*self.path.t[before].tolist(), t], [*self.path.base_T_tip[before], here]
        _append(times, poses, _raise_pose(here, up, float(self.path.base_T_tip[-1, :3, 3] @ up)))
        return Motion(Trajectory(np.array(times), np.stack(poses)), min(self.start, t), min(self.end, t))


def motion_around(scan: Trajectory, base_T_tip: Array | None) -> Motion:
    """The motion that makes `scan` from where the tip is, 4x4; None: it starts above the first waypoint.

    "Up" is against the beam at the scan's first waypoint. The tip rises to CLEARANCE above the scan's highest waypoint
    unless it is higher already, travels level, comes down along the beam, and rises along it after the scan.
    """
    first, last = scan.base_T_tip[0], scan.base_T_tip[-1]
    up = -first[:3, 2]
    top = float((scan.base_T_tip[:, :3, 3] @ up).max()) + CLEARANCE
    legs = [first]
    if base_T_tip is None:
        legs.insert(0, _raise_pose(first, up, top))
    else:
        height = max(top, float(base_T_tip[:3, 3] @ up))
        legs[:0] = [base_T_tip, _raise_pose(base_T_tip, up, height), _raise_pose(first, up, height)]
    times, poses = [0.0], [legs[0]]
    for pose in legs[1:]:
        _append(times, poses, pose)
    start = times[-1]
    times += (start + scan.t[1:] - scan.t[0]).tolist()
    poses[-1:] = list(scan.base_T_tip)
    end = times[-1]
    _append(times, poses, _raise_pose(last, up, top))
    return Motion(Trajectory(np.array(times), np.stack(poses)), start, end)


def motion_after(motions: Sequence[Motion], scan: Trajectory) -> Motion:
    """The motion that makes `scan` from where the last of `motions` ended, if there is one."""
    return motion_around(scan, motions[-1].path.base_T_tip[-1] if motions else None)


def _raise_pose(base_T_tip: Array, up: Array, height: float) -> Array:
    """The pose moved along `up` to `height`, m."""
    raised = base_T_tip.copy()
    raised[:3, 3] += up * (height - base_T_tip[:3, 3] @ up)
    return raised


def _append(times: list[float], poses: list[Array], pose: Array) -> None:
    """A leg from the last pose to `pose` at TRAVEL_SPEED; none if that is where the tip is."""
    if np.array_equal(pose, poses[-1]):
        return
    distance = float(np.linalg.norm(pose[:3, 3] - poses[-1][:3, 3]))
    angle = float(np.linalg.norm(vector_from_rotation(poses[-1][:3, :3].T @ pose[:3, :3])))
    times.append(times[-1] + max(distance / TRAVEL_SPEED, angle / _TURN_SPEED, _SHORTEST))
    poses.append(pose)
