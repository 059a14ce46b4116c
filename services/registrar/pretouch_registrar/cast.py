"""A scan that has not been made yet, simulated on what the camera saw."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch_registrar.engines.camera_model import KIND, OBJECT, PLANE
from pretouch_registrar.engines.explanation import project
from pretouch_registrar.engines.problem import Problem
from pretouch_registrar.engines.turns import rotation_of

_REACH = 0.012
"""m: a beam that is seen this far behind a surface has not pierced it there; it has gone past its edge."""
_PACE = 0.0015
"""m along the beam between two looks."""


def cast(problem: Problem, truths: Array, origins: Array, directions: Array, range_min: float) -> Array:
    """Ranges (t, n), m, of beams (n, 3), (n, 3) if the corrections `truths` (t, 6) were right; inf is a miss.

    A beam ends where it dips behind the seen surface, or at the table's plane. Through what the camera could not see it
    goes on: behind an object is mostly its table.
    """
    ranges: Array = _cast(
        truths, origins, directions, range_min, problem.centroid, problem.optics, problem.table, problem.model.pixels
    )
    return ranges


@njit(cache=True, nogil=True)
def _cast(
    truths: Array, origins: Array, directions: Array, range_min: float, centroid: Array, optics: Array, table: Array,
    pixels: NDArray[np.float32],
) -> Array:  # fmt: skip
    result = np.full((truths.shape[0], origins.shape[0]), np.inf)
    for k in range(truths.shape[0]):
        x = truths[k]
        r = rotation_of(x[:3])
        for n in range(origins.shape[0]):
            o, d = origins[n], directions[n]
            y0, y1, y2 = o[0] - centroid[0] - x[3], o[1] - centroid[1] - x[4], o[2] - centroid[2] - x[5]
            d0 = r[0, 0] * d[0] + r[1, 0] * d[1] + r[2, 0] * d[2]
            d1 = r[0, 1] * d[0] + r[1, 1] * d[1] + r[2, 1] * d[2]
            d2 = r[0, 2] * d[0] + r[1, 2] * d[1] + r[2, 2] * d[2]
            q0 = r[0, 0] * y0 + r[1, 0] * y1 + r[2, 0] * y2 + centroid[0]
            q1 = r[0, 1] * y0 + r[1, 1] * y1 + r[2, 1] * y2 + centroid[1]
            q2 = r[0, 2] * y0 + r[1, 2] * y1 + r[2, 2] * y2 + centroid[2]
            travelled = range_min
            while travelled < optics[16]:
                p0, p1, p2 = q0 + travelled * d0, q1 + travelled * d1, q2 + travelled * d2
                if table[0] * p0 + table[1] * p1 + table[2] * p2 <= table[3]:
                    result[k, n] = travelled
                    break
                u, v, depth = project(p0, p1, p2, optics)
                i, j = int(np.floor(v + 0.5)), int(np.floor(u + 0.5))
                if depth > 0 and i >= 0 and j >= 0 and i < pixels.shape[0] and j < pixels.shape[1]:
                    pixel = pixels[i, j]
                    if pixel[KIND] == OBJECT:
                        surface = pixel[PLANE] * p0 + pixel[PLANE + 1] * p1 + pixel[PLANE + 2] * p2 - pixel[PLANE + 3]
                        if -_REACH < surface <= 0:
                            result[k, n] = travelled
                            break
                travelled += _PACE
    return result
