"""The path of the tip: poses in the order of time, interpolated between."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from enum import Enum

import numpy as np

from pretouch.geometry import Array, Pose
from pretouch.trajectory import Trajectory

MAX_GAP = 0.25
"""Longest gap between two poses, s, that is interpolated: 12 mm at 5 cm/s."""
MAX_POSES = 120_000
"""Poses remembered of one path: ten minutes at 200 Hz."""


class PoseAvailability(Enum):
    """Whether a path has the tip's pose at a certain time."""

    AVAILABLE = "within the path"
    PENDING = "after the newest pose: available once later poses arrive"
    UNAVAILABLE = "before the oldest pose, or within a gap"


class PosePath:
    """The tip poses, in base, that one robot sent."""

    def __init__(self, times: Sequence[float] = (), matrices: Sequence[Array] = ()) -> None:
        self._t = list(times)
        self._matrices = list(matrices)

    @property
    def end(self) -> float | None:
        """Unix time of the newest pose, s; None before the first."""
        return self._t[-1] if self._t else None

    def append(self, t: float, base_T_tip: Pose) -> bool:
        """Adds the pose at `t`, s, unless the newest is as new; returns False if that is newer."""
        if self._t and t <= self._t[-1]:
            return t == self._t[-1]
        if len(self._t) == MAX_POSES:
            del self._t[: MAX_POSES // 10], self._matrices[: MAX_POSES // 10]
        self._t.append(t)
        self._matrices.append(base_T_tip.matrix)
        return True

    def availability(self, t: float) -> PoseAvailability:
        """Whether the path has a pose at `t`, s: never extrapolated, nor interpolated across more than `MAX_GAP`."""
        after = bisect_left(self._t, t)
        if after == len(self._t):
            return PoseAvailability.PENDING
        if self._t[after] == t or (after > 0 and self._t[after] - self._t[after - 1] <= MAX_GAP):
            return PoseAvailability.AVAILABLE
        return PoseAvailability.UNAVAILABLE

    def at(self, times: Sequence[float]) -> Array:
        """base_T_tip (n, 4, 4) at times (n,), s, each of which is `AVAILABLE`."""
        part = self.between(min(times), max(times))
        return Trajectory(np.array(part._t), np.array(part._matrices)).at(times)

    def segments(self, times: Sequence[float]) -> tuple[Array, Array, Array]:
        """The straight segments of the path on which `times` (n,), s, lie, each of which is `AVAILABLE`.

        Returns:
            base_T_tip (n, 4, 4) at their starts and (n, 4, 4) at their ends, and (n,) their durations, s. A path of
            one pose stands still.
        """
        if len(self._t) == 1:
            still = np.broadcast_to(self._matrices[0], (len(times), 4, 4))
            return still, still, np.ones(len(times))
        ends = [min(max(bisect_left(self._t, t), 1), len(self._t) - 1) for t in times]
        return (
            np.array([self._matrices[end - 1] for end in ends]).reshape(-1, 4, 4),
            np.array([self._matrices[end] for end in ends]).reshape(-1, 4, 4),
            np.array([self._t[end] - self._t[end - 1] for end in ends]),
        )

    def between(self, start: float, end: float) -> PosePath:
        """The poses between two times, s, with one more on either side where there is one."""
        span = slice(max(0, bisect_left(self._t, start) - 1), bisect_left(self._t, end) + 1)
        return PosePath(self._t[span], self._matrices[span])
