"""A timed path of the fingertip: straight lines and slerp between waypoints."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from pretouch.errors import InvalidInput
from pretouch.geometry import (
    MAX_DISTANCE,
    Array,
    check_poses,
    frozen_array,
    rotations_from_vectors,
    vector_from_rotation,
)
from pretouch.tof import MAX_TIME

APPROACH_SECONDS = 1.5
"""s: what a scan costs the robot besides its duration: to lift the tip from the scan before, travel, and come down.

A round number: with a clearance of 15 cm and 25 cm/s the simulated robot takes 1.3 s for the first scan, from above it,
and 1.9 s for each later one (means over six meshes, four scans each).
"""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Timed tip poses.

    Attributes:
        t: (n,) times in seconds, strictly increasing, n >= 1.
        base_T_tip: (n, 4, 4) poses of the tip in base, translation in metres; the tip frame has z along the beam.

    Raises:
        Malformed: a number is not finite.
        InvalidInput: a number too large, no waypoint, times out of order, or a matrix that is no pose.
    """

    t: Array
    base_T_tip: Array

    def __post_init__(self) -> None:
        t = frozen_array(self.t, (None,), "waypoints.t", MAX_TIME)
        poses = frozen_array(self.base_T_tip, (len(t), 4, 4), "waypoints.base_T_tip", MAX_DISTANCE)
        if len(t) == 0 or (np.diff(t) <= 0).any():
            raise InvalidInput("The waypoints' times do not increase strictly.", "Send one waypoint or more, in order.")
        check_poses(poses, "waypoints")
        object.__setattr__(self, "t", t)
        object.__setattr__(self, "base_T_tip", poses)

    @property
    def duration(self) -> float:
        """s from the first to the last waypoint."""
        return float(self.t[-1] - self.t[0])

    @property
    def length(self) -> float:
        """m travelled by the tip's origin."""
        return float(np.linalg.norm(np.diff(self.base_T_tip[:, :3, 3], axis=0), axis=1).sum())

    def at(self, times: ArrayLike) -> Array:
        """Tip poses (m, 4, 4) at times (m,), s, interpolated.

        Raises:
            InvalidInput: a time outside the trajectory: it is not extrapolated.
        """
        wanted = frozen_array(times, (None,), "times")
        if len(wanted) and (wanted.min() < self.t[0] or wanted.max() > self.t[-1]):
            raise InvalidInput(
                f"Times {wanted.min():.6f} to {wanted.max():.6f} s leave the trajectory's "
                f"{self.t[0]:.6f} to {self.t[-1]:.6f} s.",
                "Give tip poses that cover the samples' times.",
            )
        if len(self.t) == 1:
            return np.repeat(self.base_T_tip, len(wanted), axis=0)
        after = np.clip(np.searchsorted(self.t, wanted, side="right"), 1, len(self.t) - 1)
        share = (wanted - self.t[after - 1]) / (self.t[after] - self.t[after - 1])
        a, b = self.base_T_tip[after - 1], self.base_T_tip[after]
        poses = np.tile(np.eye(4), (len(wanted), 1, 1))
        poses[:, :3, 3] = a[:, :3, 3] + share[:, None] * (b[:, :3, 3] - a[:, :3, 3])
        poses[:, :3, :3] = a[:, :3, :3]
        if self._turns.any():
            poses[:, :3, :3] @= rotations_from_vectors(share[:, None] * self._turns[after - 1])
        return poses

    @cached_property
    def _turns(self) -> Array:
        """(n - 1, 3) rad: the rotation vector of each waypoint to the next, in the first one's axes."""
        steps = np.swapaxes(self.base_T_tip[:-1, :3, :3], 1, 2) @ self.base_T_tip[1:, :3, :3]
        turns = np.zeros((len(steps), 3))
        for k in np.flatnonzero(np.abs(steps - np.eye(3)).max(axis=(1, 2)) > 1e-12):
            turns[k] = vector_from_rotation(steps[k])
        return turns

    def between(self, start: float, end: float) -> Trajectory:
        """The piece from `start` to `end`, s, at the same times.

        Raises:
            InvalidInput: it leaves the trajectory, or ends before it starts.
        """
        within = (self.t > start + 1e-9) & (self.t < end - 1e-9)
        times = np.concatenate([[start], self.t[within], [end][: end != start]])
        return Trajectory(times, self.at(times))

    def sampled(self, rate: float) -> Trajectory:
        """The same path with a waypoint every 1 / `rate` seconds from its start."""
        times = self.t[0] + np.arange(int(np.floor(self.duration * rate + 1e-9)) + 1) / rate
        times = np.minimum(times, self.t[-1])
        return Trajectory(times, self.at(times))
