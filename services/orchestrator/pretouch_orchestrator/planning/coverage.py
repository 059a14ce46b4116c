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
_PREDICTED_POINTS = 400
_LEAST_STEP = 0.001
"""m between the samples that are predicted: of a slow or fast sampling finger those between them show the same."""
_MAX_MODULES = 16
"""Modules whose beams are cast: those of a multizone sensor are closer together than the radius that counts."""


def find_scanned(cloud: Array, scans: Sequence[Scan]) -> NDArray[np.bool_]:
    """(n,): which points of `cloud` (n, 3), m, in base as presently corrected, lie within 5 mm of a returned sample."""
    hits = np.concatenate([np.zeros((0, 3)), *(scan.points() for scan in scans)])
    if len(hits) == 0:
        return np.zeros(len(cloud), dtype=bool)
    distances, _ = KDTree(hits).query(cloud, distance_upper_bound=_SCANNED_RADIUS)
    return np.asarray(np.isfinite(distances), dtype=bool)


class CoveragePredictor:
    """Predicts the share of the object's points that one more scan leaves scanned, by casting thin beams on the cloud.

    Args:
        cloud: (n, 3), m, in base as presently corrected.
        scans: those made so far, as beams in base.
        base_R_tip: (3, 3), the tip's orientation on all predicted paths.
    """

    def __init__(self, cloud: Array, scans: Sequence[Scan], sensor: Sensor, base_R_tip: Array) -> None:
        points = cloud[:: max(1, len(cloud) // _PREDICTED_POINTS)]
        self._scanned = find_scanned(points, scans)
        self._sensor, self._axes = sensor, base_R_tip
        self._seen = points @ base_R_tip
        self._cloud = KDTree(self._seen)
        modules = sensor.tip_T_module[:: -(-len(sensor.tip_T_module) // _MAX_MODULES)]
        self._views = [(module, KDTree((self._seen @ module.rotation)[:, :2])) for module in modules]

    def predict_fractions(self, path: Trajectory, spans: Sequence[tuple[float, float]]) -> Array:
        """(k,): the share of the object that is scanned after a scan of each span (start, end), s, of a path."""
        slowest = np.finfo(np.float64).max  # 1 / rate may overflow
        seconds = max(min(1 / self._sensor.rate, slowest), path.duration * _LEAST_STEP / max(path.length, _LEAST_STEP))
        times = np.asarray(np.arange(int(path.duration / seconds) + 1) * seconds, dtype=np.float64)
        reached = np.zeros((len(times) + 1, len(self._seen)), dtype=np.int16)
        for k, points in self._find_reached(path, times):
            reached[k + 1, points] = 1
        counts = np.cumsum(reached, axis=0, dtype=np.int16)
        first, last = np.searchsorted(times, np.asarray(spans) - 1e-9).T
        scanned = (counts[last] > counts[first]) | self._scanned
        return np.asarray(scanned.mean(axis=1), dtype=np.float64)

    def _find_reached(self, path: Trajectory, times: Array) -> list[tuple[int, list[int]]]:
        """The index of one of the times (n,), s within the path, and the points scanned: for each beam that returns."""
        tips = np.stack([np.interp(times + path.t[0], path.t, path.base_T_tip[:, k, 3]) for k in range(3)], axis=1)
        reached: list[tuple[int, list[int]]] = []
        for module, view in self._views:
            origins = (tips @ self._axes + module.translation) @ module.rotation
            beside, nearest = view.query(origins[:, :2], k=4, distance_upper_bound=_BEAM_RADIUS)
            depths = np.append(self._seen @ module.rotation[:, 2], np.inf)[nearest]
            ahead = np.isfinite(beside) & (depths > origins[:, 2:])
            depth = np.where(ahead, depths, np.inf).min(axis=1)
            returned = np.flatnonzero(depth - origins[:, 2] <= self._sensor.range_max)
            ends = np.column_stack([origins[returned, :2], depth[returned]]) @ module.rotation.T
            reached += zip(returned.tolist(), self._cloud.query_ball_point(ends, _SCANNED_RADIUS), strict=True)
        return reached
