"""A thin beam without a return: it pays where it would have pierced the object that the camera saw."""

from __future__ import annotations

from numba import njit

from pretouch_registrar.engines.compiled import NO_REFERENCES
from pretouch_registrar.engines.correction import Vector
from pretouch_registrar.engines.problem import Noise, Target
from pretouch_registrar.engines.projection import cell_of, height_above
from pretouch_registrar.engines.residuals.inside import BELOW, depth_inside
from pretouch_registrar.engines.robust_kernel import CAP_FRONT, robust_cost

_PACE = 0.01
"""m along the beam between two looks."""


@njit(cache=True, nogil=True, error_model="numpy", **NO_REFERENCES)
def miss_cost(start: Vector, direction: Vector, target: Target, noise: Noise) -> float:
    """What a beam from `start`, where the camera would have put it, pays: as a point below a seen part would."""
    x, y, z = start
    dx, dy, dz = direction
    footprint = target.footprint
    for _ in range(int(target.optics.range_max / _PACE + 0.5)):
        x, y, z = x + _PACE * dx, y + _PACE * dy, z + _PACE * dz
        a, b = cell_of((x, y, z), footprint)
        if a >= 0 and footprint.top[a, b] > height_above((x, y, z), target.table) + BELOW:
            below = depth_inside(footprint, a, b, noise.edge)
            s = 0.5 * below * below
            return robust_cost(s, CAP_FRONT)
    return 0.0
