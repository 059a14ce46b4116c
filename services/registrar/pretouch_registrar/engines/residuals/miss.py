"""The cost of a thin beam without a return that passes through the seen surface."""

from __future__ import annotations

from numba import njit

from pretouch_registrar.engines.compiled import NO_REFERENCES
from pretouch_registrar.engines.correction import Vector
from pretouch_registrar.engines.projection import compute_height, find_cell
from pretouch_registrar.engines.registration_problem import Noise, Target
from pretouch_registrar.engines.residuals.inside import BELOW, depth_inside
from pretouch_registrar.engines.robust_kernel import CAP_FRONT, robust_cost

_STEP = 0.01
"""m along the beam."""


@njit(cache=True, nogil=True, error_model="numpy", **NO_REFERENCES)
def miss_cost(start: Vector, direction: Vector, target: Target, noise: Noise) -> float:
    """The cost of a miss from `start`, as carried back: that of a point below the seen surface."""
    x, y, z = start
    dx, dy, dz = direction
    footprint = target.footprint
    for _ in range(int(target.optics.range_max / _STEP + 0.5)):
        x, y, z = x + _STEP * dx, y + _STEP * dy, z + _STEP * dz
        a, b = find_cell((x, y, z), footprint)
        if a >= 0 and footprint.top[a, b] > compute_height((x, y, z), target.table) + BELOW:
            below = depth_inside(footprint, a, b, noise.edge)
            s = 0.5 * below * below
            return robust_cost(s, CAP_FRONT)
    return 0.0
