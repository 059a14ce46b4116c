"""Beams that repeat earlier ones which returned nothing.

The world stands still, and the finger measures in its own frame: whatever the correction, a beam along an earlier one
that met nothing within the sensor's range will meet nothing either, unless the finger is lower now.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch_registrar.engines.registration_problem import Beams

_RADIUS = 0.004
"""m across the beam within which an earlier beam is the same one."""
_MIN_COSINE = float(np.cos(np.radians(3.0)))
_DESCENT = 0.005
"""m along the beam that the finger may be lower than before."""


@njit(cache=True, nogil=True)
def find_repeated_misses(earlier: Beams, origins: Array, directions: Array) -> NDArray[np.bool_]:
    """(n,): which beams from `origins` (n, 3), m, along `directions` (n, 3) repeat more misses than returns."""
    repeated = np.zeros(origins.shape[0], dtype=np.bool_)
    for n in range(origins.shape[0]):
        missed = 0
        for m in range(earlier.ranges.shape[0]):
            dx, dy, dz = earlier.directions[m, 0], earlier.directions[m, 1], earlier.directions[m, 2]
            if dx * directions[n, 0] + dy * directions[n, 1] + dz * directions[n, 2] <= _MIN_COSINE:
                continue
            x = origins[n, 0] - earlier.points[m, 0]
            y = origins[n, 1] - earlier.points[m, 1]
            z = origins[n, 2] - earlier.points[m, 2]
            along = x * dx + y * dy + z * dz
            if x * x + y * y + z * z - along * along >= _RADIUS * _RADIUS:
                continue
            if earlier.returned[m]:
                missed -= 1
            elif along < _DESCENT:  # without a return, the point is where the beam began
                missed += 1
        repeated[n] = missed > 0
    return repeated
