"""The expected mean distance between estimated and true points under a pose covariance."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pretouch.geometry import Array

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)
_ANGLES = 0.25 * np.pi * (_NODES + 1.0)
_TIMES, _SHARES = np.tan(_ANGLES) ** 2, 0.25 * np.sqrt(np.pi) * _WEIGHTS / np.sin(_ANGLES) ** 2


def compute_expected_errors(covariances: ArrayLike, arms: ArrayLike) -> Array:
    """(k,), m: expectation of the mean length of w x a + d over the arms a.

    The square of a normal vector's length has the Laplace transform det(I + 2 t S)^-1/2, with S its covariance, and
    the expectation of the root of a positive variable q is the integral of (1 - E exp(-t q)) t^-3/2 / (2 sqrt pi) over
    t > 0 (Mathai and Provost, "Quadratic forms in random variables", 1992). With t = tan^2 / trace S it is smooth, and
    twelve nodes give six digits.

    Args:
        covariances: (k, 6, 6) of pose errors (w, d), rad and m, w about the points' centroid.
        arms: (n, 3), m, from the centroid to the points.
    """
    arms = np.asarray(arms, dtype=np.float64)
    turned = np.cross(np.eye(3), arms[:, None]).swapaxes(1, 2)
    move = np.concatenate([turned, np.broadcast_to(np.eye(3), turned.shape)], axis=2)
    of_points = move @ np.asarray(covariances, dtype=np.float64)[:, None] @ move.swapaxes(1, 2)
    total = np.maximum(np.trace(of_points, axis1=-2, axis2=-1), 1e-30)
    of_points = of_points / total[..., None, None]
    pairs = 0.5 * (1.0 - (of_points * of_points).sum(axis=(-2, -1)))[..., None]
    triple = np.linalg.det(of_points)[..., None]
    t = 2.0 * _TIMES
    transforms = 1.0 / np.sqrt(1.0 + t + t**2 * np.maximum(pairs, 0.0) + t**3 * np.maximum(triple, 0.0))
    return np.asarray((np.sqrt(total) * ((1.0 - transforms) @ _SHARES)).mean(axis=1), dtype=np.float64)
