"""The prior of a correction's components: nearly uniform up to a bound, as calibration errors are."""

from __future__ import annotations

import numpy as np
from numba import njit

FLAT_SIGMAS = 1.65
"""Standard deviations up to which the prior is nearly flat; a uniform error's bound is sqrt 3 of them."""
FALL_OFF_SIGMAS = 0.2
"""Standard deviations over which the density falls off beyond FLAT_SIGMAS."""
FLAT_COST_SHARE = 0.1
"""Share of a normal prior's cost that counts within FLAT_SIGMAS."""


@njit(cache=True, nogil=True, inline="always")
def prior_cost(x: float, inverse_variance: float) -> tuple[float, float, float]:
    """Cost of one component of a correction, and its first and second derivative."""
    scale = np.sqrt(inverse_variance)
    z = x * scale
    beyond = abs(z) - FLAT_SIGMAS
    cost, slope, bend = 0.5 * FLAT_COST_SHARE * z * z, FLAT_COST_SHARE * z, FLAT_COST_SHARE
    if beyond > 0:
        cost += 0.5 * (beyond / FALL_OFF_SIGMAS) ** 2
        slope += np.sign(z) * beyond / FALL_OFF_SIGMAS**2
        bend += 1.0 / FALL_OFF_SIGMAS**2
    return cost, slope * scale, bend * inverse_variance
