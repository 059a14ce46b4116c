"""The prior of a correction's components: flat up to a wall, as calibration errors are bounded, not normal."""

from __future__ import annotations

import numpy as np
from numba import njit

FLAT = 1.65
"""Standard deviations up to which a correction costs next to nothing; a uniform error's bound is sqrt 3 of them."""
WALL = 0.2
"""Standard deviations over which the prior falls off beyond."""
SAG = 0.1
"""Share of a normal prior's cost within."""


@njit(cache=True, nogil=True, inline="always")
def prior_cost(x: float, inverse_variance: float) -> tuple[float, float, float]:
    """Cost, slope and curvature of one component of a correction."""
    scale = np.sqrt(inverse_variance)
    z = x * scale
    beyond = abs(z) - FLAT
    cost, slope, bend = 0.5 * SAG * z * z, SAG * z, SAG
    if beyond > 0:
        cost += 0.5 * (beyond / WALL) ** 2
        slope += np.sign(z) * beyond / WALL**2
        bend += 1.0 / WALL**2
    return cost, slope * scale, bend * inverse_variance
