"""What a scan that has not been made yet would tell: simulated on what the camera saw."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch.tof import Scan, Sensor
from pretouch.trajectory import Trajectory
from pretouch_registrar.engines.agreement import Problem, beam_rows, project, rotation_of
from pretouch_registrar.engines.camera_model import KIND, OBJECT, OTHER, PLANE, UNSEEN
from pretouch_registrar.engines.posterior import curvature

_TRUTHS = 2
"""Poses drawn from the present estimate that are taken as the truth in turn."""
_MAX_BEAMS = 60
_REACH = 0.012
"""m: a beam that is seen this far behind a surface has not pierced it there; it has gone past its edge."""


def predicted_information(problem: Problem, x: Array, covariance: Array, path: Trajectory, sensor: Sensor) -> Array:
    """Information (6, 6) that a scan along `path` would add to the estimate x (6,) with `covariance` (6, 6).

    The mean over a few truths drawn from the estimate: the beams are cast onto the camera's surface moved there, the
    cost's curvature is taken around that truth. Beams into what the camera could not see tell nothing.
    """
    poses = path.sampled(min(sensor.rate, _MAX_BEAMS / max(path.duration, 1e-9))).base_T_tip
    modules = np.stack([pose.matrix for pose in sensor.tip_T_module])
    base_T_module = (poses[:, None] @ modules[None]).reshape(-1, 4, 4)
    origins = np.ascontiguousarray(base_T_module[:, :3, 3])
    directions = np.ascontiguousarray(base_T_module[:, :3, 2])
    root = np.linalg.cholesky(covariance)
    normal = np.random.default_rng(1).standard_normal((_TRUTHS // 2, 6))
    total = np.zeros((6, 6))
    for draw in np.concatenate([normal, -normal]):
        truth = x + root @ draw
        ranges = _cast(
            truth, origins, directions, problem.centroid, problem.optics, problem.table, sensor.range_min,
            problem.model.pixels,
        )  # fmt: skip
        known = ranges >= 0
        ranges[ranges > sensor.range_max] = np.nan
        scan = Scan(origins[known], directions[known], ranges[known])
        seen = replace(problem, beams=beam_rows([scan], sensor), prior=np.zeros(6))
        total += curvature(seen, truth, covariance)
    return total / _TRUTHS


@njit(cache=True, nogil=True)
def _cast(
    x: Array, origins: Array, directions: Array, centroid: Array, optics: Array, table: Array, range_min: float,
    pixels: NDArray[np.float32],
) -> Array:  # fmt: skip
    """Ranges (n,) of beams onto the camera's surface under the correction x (6,): inf is a miss, -1 is not known.

    Marches in 1.5 mm steps; a beam ends where it dips behind the seen surface, or at the table's plane.
    """
    r = rotation_of(x[:3])
    result = np.empty(origins.shape[0])
    pace = 0.0015
    for n in range(origins.shape[0]):
        o, d = origins[n], directions[n]
        y0, y1, y2 = o[0] - centroid[0] - x[3], o[1] - centroid[1] - x[4], o[2] - centroid[2] - x[5]
        d0 = r[0, 0] * d[0] + r[1, 0] * d[1] + r[2, 0] * d[2]
        d1 = r[0, 1] * d[0] + r[1, 1] * d[1] + r[2, 1] * d[2]
        d2 = r[0, 2] * d[0] + r[1, 2] * d[1] + r[2, 2] * d[2]
        q0 = r[0, 0] * y0 + r[1, 0] * y1 + r[2, 0] * y2 + centroid[0]
        q1 = r[0, 1] * y0 + r[1, 1] * y1 + r[2, 1] * y2 + centroid[1]
        q2 = r[0, 2] * y0 + r[1, 2] * y1 + r[2, 2] * y2 + centroid[2]
        result[n] = np.inf
        travelled = range_min
        hidden = False
        while travelled < optics[16]:
            p0, p1, p2 = q0 + travelled * d0, q1 + travelled * d1, q2 + travelled * d2
            u, v, depth = project(p0, p1, p2, optics)
            i, j = int(np.floor(v + 0.5)), int(np.floor(u + 0.5))
            hidden = False
            if depth > 0 and i >= 0 and j >= 0 and i < pixels.shape[0] and j < pixels.shape[1]:
                pixel = pixels[i, j]
                hidden = pixel[KIND] == UNSEEN or pixel[KIND] == OTHER
                if pixel[KIND] == OBJECT:
                    surface = pixel[PLANE] * p0 + pixel[PLANE + 1] * p1 + pixel[PLANE + 2] * p2 - pixel[PLANE + 3]
                    if -_REACH < surface <= 0:
                        result[n] = travelled
                        break
                    hidden = surface <= 0
            if table[0] * p0 + table[1] * p1 + table[2] * p2 <= table[3]:
                result[n] = -1.0 if hidden else travelled
                break
            travelled += pace
        if hidden and not np.isfinite(result[n]):
            result[n] = -1.0
    return result
