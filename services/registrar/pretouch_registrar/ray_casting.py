"""A scan that has not been made yet, simulated on what the camera saw."""

from __future__ import annotations

import numpy as np
from numba import njit

from pretouch.geometry import Array
from pretouch_registrar.engines import so3
from pretouch_registrar.engines.camera_model import OBJECT
from pretouch_registrar.engines.compiled import NO_REFERENCES
from pretouch_registrar.engines.correction import Vector, carried_back, turned_back
from pretouch_registrar.engines.problem import Problem, Target
from pretouch_registrar.engines.projection import pixel_of, project

_REACH = 0.012
"""m: a beam that is seen this far behind a surface has not pierced it there; it has gone past its edge."""
_PACE = 0.0015
"""m along the beam between two looks."""


def cast(problem: Problem, truths: Array, origins: Array, directions: Array, range_min: float) -> Array:
    """Ranges (t, n), m, of beams (n, 3), (n, 3) if the corrections `truths` (t, 6) were right; inf is a miss.

    A beam ends where it dips behind the seen surface, or at the table's plane. Through what the camera could not see it
    goes on: behind an object is mostly its table.
    """
    ranges: Array = _cast(truths, origins, directions, range_min, problem.target)
    return ranges


@njit(cache=True, nogil=True)
def _cast(truths: Array, origins: Array, directions: Array, range_min: float, target: Target) -> Array:
    result = np.full((truths.shape[0], origins.shape[0]), np.inf)
    for k in range(truths.shape[0]):
        r = so3.exp(truths[k, :3])
        for n in range(origins.shape[0]):
            origin = carried_back(truths[k], r, target.centroid, origins, n)
            result[k, n] = _path(origin, turned_back(r, directions, n), range_min, target)
    return result


@njit(cache=True, nogil=True, **NO_REFERENCES)
def _path(origin: Vector, direction: Vector, range_min: float, target: Target) -> float:
    """m: the range of one beam, given where the camera would have put it."""
    table, kinds, surface = target.table, target.pixels.kinds, target.pixels.surface
    q0, q1, q2 = origin
    d0, d1, d2 = direction
    travelled = range_min
    while travelled < target.optics.range_max:
        p0, p1, p2 = q0 + travelled * d0, q1 + travelled * d1, q2 + travelled * d2
        if table.normal[0] * p0 + table.normal[1] * p1 + table.normal[2] * p2 <= table.offset:
            return travelled
        u, v, depth = project((p0, p1, p2), target.optics)
        i, j = pixel_of(u, v)
        inside = depth > 0 and i >= 0 and j >= 0 and i < kinds.shape[0] and j < kinds.shape[1]
        if inside and kinds[i, j] == OBJECT:
            normal = surface.normals[i, j]
            behind = normal[0] * p0 + normal[1] * p1 + normal[2] * p2 - surface.offsets[i, j]
            if -_REACH < behind <= 0:
                return travelled
        travelled += _PACE
    return np.inf
