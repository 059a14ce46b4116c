"""How much of the object the finger has scanned, and would have after one more scan."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from pretouch.geometry import Array
from pretouch.tof import Scan, Sensor
from pretouch.trajectory import Trajectory

_NEAR = 0.005
"""m from a returned sample's point within which the object counts as scanned."""
_BEAM = 0.003
"""m around a foreseen beam within which the object's points stop it."""
_FORESEEN_POINTS = 1500


def scanned(cloud: Array, scans: Sequence[Scan]) -> NDArray[np.bool_]:
    """(n,): which points of `cloud` (n, 3), m, in base as presently corrected, lie within 5 mm of a returned sample."""
    return _near(cloud, np.concatenate([np.zeros((0, 3)), *(scan.points() for scan in scans)]))


class Foresight:
    """What share of the object's points will be scanned after one more scan: that of the cloud itself by a thin beam.

    Args:
        cloud: (n, 3), m, in base as presently corrected.
        scans: those made so far.
        base_R_tip: (3, 3), the tip's orientation on all paths asked about.
    """

    def __init__(self, cloud: Array, scans: Sequence[Scan], sensor: Sensor, base_R_tip: Array) -> None:
        self._points = cloud[:: max(1, len(cloud) // _FORESEEN_POINTS)]
        self._scanned = scanned(self._points, scans)
        self._sensor, self._axes = sensor, base_R_tip
        self._seen = self._points @ base_R_tip
        self._from_above = KDTree(self._seen[:, :2])

    def fraction_after(self, path: Trajectory) -> float:
        """The share once `path` is scanned too."""
        return float((self._scanned | _near(self._points, self._ends(path))).mean())

    def _ends(self, path: Trajectory) -> Array:
        """Where the beams along `path` first meet the cloud: (m, 3), m, in base."""
        times = path.t[0] + np.arange(int(path.duration * self._sensor.rate) + 1) / self._sensor.rate
        tips = np.stack([np.interp(times, path.t, path.base_T_tip[:, k, 3]) for k in range(3)], axis=1) @ self._axes
        beside, nearest = self._from_above.query(tips[:, :2], k=4, distance_upper_bound=_BEAM)
        depths = np.where(np.isfinite(beside), np.append(self._seen[:, 2], np.inf)[nearest], np.inf).min(axis=1)
        returned = depths - tips[:, 2] <= self._sensor.range_max
        return np.asarray(np.column_stack([tips[returned, :2], depths[returned]]) @ self._axes.T, dtype=np.float64)


def _near(cloud: Array, hits: Array) -> NDArray[np.bool_]:
    if len(hits) == 0:
        return np.zeros(len(cloud), dtype=bool)
    distances, _ = KDTree(hits).query(cloud, distance_upper_bound=_NEAR)
    return np.asarray(np.isfinite(distances), dtype=bool)
