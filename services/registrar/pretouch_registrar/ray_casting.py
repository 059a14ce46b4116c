"""Simulates the ranges of beams on the surface that the camera saw."""

from __future__ import annotations

import numpy as np
from numba import njit

from pretouch.geometry import Array
from pretouch_registrar.engines import so3
from pretouch_registrar.engines.camera_model import OBJECT
from pretouch_registrar.engines.compiled import NO_REFERENCES
from pretouch_registrar.engines.correction import Vector, carry_back, turn_back
from pretouch_registrar.engines.projection import find_pixel, project
from pretouch_registrar.engines.registration_problem import RegistrationProblem, Target

_MAX_DEPTH_BEHIND = 0.012
"""m: a point of a beam farther than this behind a surface has passed beside the surface's edge, not through it."""
_STEP = 0.0015
"""m along the beam."""


def cast_rays(
    problem: RegistrationProblem, truths: Array, origins: Array, directions: Array, range_min: float
) -> Array:
    """Ranges (t, n), m, of beams (n, 3), (n, 3) if the corrections `truths` (t, 6) were right; inf is a miss.

    A beam ends where it enters the seen surface, or at the table's plane. It passes through what the camera could not
    see, since behind an object there is mostly table.
    """
    ranges: Array = _cast_all(truths, origins, directions, range_min, problem.target)
    return ranges


@njit(cache=True, nogil=True)
def _cast_all(truths: Array, origins: Array, directions: Array, range_min: float, target: Target) -> Array:
    result = np.full((truths.shape[0], origins.shape[0]), np.inf)
    for k in range(truths.shape[0]):
        r = so3.exp(truths[k, :3])
        for n in range(origins.shape[0]):
            origin = carry_back(truths[k], r, target.centroid, origins, n)
            result[k, n] = _cast_ray(origin, turn_back(r, directions, n), range_min, target)
    return result


@njit(cache=True, nogil=True, **NO_REFERENCES)
def _cast_ray(origin: Vector, direction: Vector, range_min: float, target: Target) -> float:
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
        i, j = find_pixel(u, v)
        inside = depth > 0 and i >= 0 and j >= 0 and i < kinds.shape[0] and j < kinds.shape[1]
        if inside and kinds[i, j] == OBJECT:
            normal = surface.normals[i, j]
            behind = normal[0] * p0 + normal[1] * p1 + normal[2] * p2 - surface.offsets[i, j]
            if -_MAX_DEPTH_BEHIND < behind <= 0:
                return travelled
        travelled += _STEP
    return np.inf
