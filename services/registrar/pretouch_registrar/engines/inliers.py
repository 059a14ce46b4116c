"""Which samples a correction explains."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch_registrar.engines import so3
from pretouch_registrar.engines.correction import carried_back, turned_back
from pretouch_registrar.engines.problem import Problem
from pretouch_registrar.engines.residuals.point import NORMAL, PointResiduals, half_square, point_residual

_HALF_GATE = 4.5
"""Half the squared normalised residual, 3 sigma, up to which a return agrees."""


@njit(cache=True, nogil=True, error_model="numpy")
def sample_residuals(x: Array, problem: Problem) -> tuple[Array, NDArray[np.bool_]]:
    """For each beam (n,): its residual along the surface's normal, m, and whether it agrees within 3 sigma.

    Misses do not agree with anything.
    """
    beams, target = problem.beams, problem.target
    r = so3.exp(x[:3])
    out = PointResiduals(np.zeros(3), np.zeros((3, 3)))
    residual = np.zeros(beams.weights.shape[0])
    agrees = np.zeros(beams.weights.shape[0], dtype=np.bool_)
    for n in range(beams.weights.shape[0]):
        if not beams.returned[n]:
            continue
        point = carried_back(x, r, target.centroid, beams.points, n)
        direction = turned_back(r, beams.directions, n)
        point_residual(point, direction, target, problem.noise, out)
        slope = out.gradients[NORMAL]
        residual[n] = out.values[NORMAL] / np.sqrt(slope[0] * slope[0] + slope[1] * slope[1] + slope[2] * slope[2])
        agrees[n] = half_square(out) < _HALF_GATE
    return residual, agrees
