"""Which share of the object is scanned, and which share is predicted to be scanned after one more scan."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from pretouch.geometry import Array
from pretouch.tof import Scan, Sensor
from pretouch.trajectory import Trajectory

_SCANNED_RADIUS = 0.005
"""m from a returned sample's point within which the object counts as scanned."""
_BEAM_RADIUS = 0.003
"""m around a predicted beam within which a point of the object stops it."""
_PREDICTED_POINTS = 1500


def find_scanned(cloud: Array, scans: Sequence[Scan]) -> NDArray[np.bool_]:
    """(n,): which points of `cloud` (n, 3), m, in base as presently corrected, lie within 5 mm of a returned sample."""
    return _find_near(cloud, np.concatenate([np.zeros((0, 3)), *(scan.points() for scan in scans)]))


class CoveragePredictor:
    """Predicts the share of the object's points that one more scan leaves scanned, by casting thin beams on the cloud.

    Args:
        cloud: (n, 3), m, in base as presently corrected.
        scans: those made so far, as beams in base.
        base_R_tip: (3, 3), the tip's orientation on all predicted paths.
    """

    def __init__(self, cloud: Array, scans: Sequence[Scan], sensor: Sensor, base_R_tip: Array) -> None:
        self._points = cloud[:: max(1, len(cloud) // _PREDICTED_POINTS)]
        self._scanned = find_scanned(self._points, scans)
        self._sensor, self._axes = sensor, base_R_tip
        self._seen = self._points @ base_R_tip
        self._top_view = KDTree(self._seen[:, :2])

    def predict_fraction(self, path: Trajectory) -> float:
        """The share of the object that is scanned after a scan along `path`."""
        return float((self._scanned | _find_near(self._points, self._predict_hits(path))).mean())

    def _predict_hits(self, path: Trajectory) -> Array:
        """Where the beams along `path` first meet the cloud: (m, 3), m, in base."""
        times = path.t[0] + np.arange(int(path.duration * self._sensor.rate) + 1) / self._sensor.rate
        tips = np.stack([np.interp(times, path.t, path.base_T_tip[:, k, 3]) for k in range(3)], axis=1) @ self._axes
        beside, nearest = self._top_view.query(tips[:, :2], k=4, distance_upper_bound=_BEAM_RADIUS)
        depths = np.where(np.isfinite(beside), np.append(self._seen[:, 2], np.inf)[nearest], np.inf).min(axis=1)
        returned = depths - tips[:, 2] <= self._sensor.range_max
        return np.asarray(np.column_stack([tips[returned, :2], depths[returned]]) @ self._axes.T, dtype=np.float64)


def _find_near(cloud: Array, hits: Array) -> NDArray[np.bool_]:
    if len(hits) == 0:
        return np.zeros(len(cloud), dtype=bool)
    distances, _ = KDTree(hits).query(cloud, distance_upper_bound=_SCANNED_RADIUS)
    return np.asarray(np.isfinite(distances), dtype=bool)
