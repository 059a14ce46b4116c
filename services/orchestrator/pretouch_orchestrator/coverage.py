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
_FORESEEN_POINTS = 2000


def scanned(cloud: Array, scans: Sequence[Scan]) -> NDArray[np.bool_]:
    """(n,): which points of `cloud` (n, 3), m, in base as presently corrected, lie within 5 mm of a returned sample."""
    return _near(cloud, np.concatenate([np.zeros((0, 3)), *(scan.points() for scan in scans)]))


def fraction_after(cloud: Array, scans: Sequence[Scan], path: Trajectory, sensor: Sensor) -> float:
    """The share of `cloud` (n, 3), m, as presently corrected, that would be scanned after `path` were scanned too.

    The foreseen scan is that of the cloud itself by a thin beam.
    """
    points = cloud[:: max(1, len(cloud) // _FORESEEN_POINTS)]
    after = scanned(points, scans) | _near(points, _foreseen(points, path, sensor))
    return float(after.mean())


def _near(cloud: Array, hits: Array) -> NDArray[np.bool_]:
    if len(hits) == 0:
        return np.zeros(len(cloud), dtype=bool)
    distances, _ = KDTree(hits).query(cloud, distance_upper_bound=_NEAR)
    return np.asarray(np.isfinite(distances), dtype=bool)


def _foreseen(cloud: Array, path: Trajectory, sensor: Sensor) -> Array:
    """Where beams along `path`, whose orientation is constant, first meet the cloud: (m, 3), m, in base."""
    axes = path.base_T_tip[0, :3, :3]
    times = path.t[0] + np.arange(int(path.duration * sensor.rate) + 1) / sensor.rate
    tips = np.stack([np.interp(times, path.t, path.base_T_tip[:, k, 3]) for k in range(3)], axis=1) @ axes
    seen = cloud @ axes
    beside, nearest = KDTree(seen[:, :2]).query(tips[:, :2], k=4, distance_upper_bound=_BEAM)
    depths = np.where(np.isfinite(beside), np.append(seen[:, 2], np.inf)[nearest], np.inf).min(axis=1)
    returned = depths - tips[:, 2] <= sensor.range_max
    return np.asarray(np.column_stack([tips[returned, :2], depths[returned]]) @ axes.T, dtype=np.float64)
