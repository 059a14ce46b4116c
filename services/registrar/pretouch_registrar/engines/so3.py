"""The exponential and the logarithm of SO(3), in compiled code."""

from __future__ import annotations

import numpy as np
from numba import njit

from pretouch.geometry import Array


@njit(cache=True, nogil=True, error_model="numpy")
def exp(w: Array) -> Array:
    """The rotation matrix (3, 3) of a rotation vector (3,), rad, by Rodrigues' formula."""
    angle = np.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    a, b = 1.0, 0.5
    if angle > 1e-8:
        a = np.sin(angle) / angle
        b = (1.0 - np.cos(angle)) / (angle * angle)
    x, y, z = w[0], w[1], w[2]
    r = np.empty((3, 3))
    r[0, 0] = 1 - b * (y * y + z * z)
    r[1, 1] = 1 - b * (x * x + z * z)
    r[2, 2] = 1 - b * (x * x + y * y)
    r[0, 1] = b * x * y - a * z
    r[1, 0] = b * x * y + a * z
    r[0, 2] = b * x * z + a * y
    r[2, 0] = b * x * z - a * y
    r[1, 2] = b * y * z - a * x
    r[2, 1] = b * y * z + a * x
    return r


@njit(cache=True, nogil=True)
def log(r: Array) -> Array:
    """The rotation vector (3,), rad, of a rotation matrix (3, 3) by less than half a turn."""
    v = 0.5 * np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    sine = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    if sine < 1e-9:
        return v
    return v * (np.arctan2(sine, 0.5 * (r[0, 0] + r[1, 1] + r[2, 2] - 1.0)) / sine)
