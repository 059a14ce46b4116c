"""The inverse of a pose correction x = (w, d), in compiled code.

The correction p -> exp(w) (p - c) + c + d maps a point from where the camera put it to where it is; c is the object's
centroid; base axes, rad and m. Its inverse carries what the finger measured back to where the camera would have put it.
"""

from __future__ import annotations

from numba import njit

from pretouch.geometry import Array

Vector = tuple[float, float, float]
"""A point or a direction in kernels, in base: no array, so that it costs no allocation."""


@njit(cache=True, nogil=True, inline="always")
def carry_back(x: Array, r: Array, centroid: Array, points: Array, n: int) -> Vector:
    """Where the camera would have put row n of points (m, 3), under x (6,) with r = exp(w) (3, 3)."""
    y0 = points[n, 0] - centroid[0] - x[3]
    y1 = points[n, 1] - centroid[1] - x[4]
    y2 = points[n, 2] - centroid[2] - x[5]
    q0 = r[0, 0] * y0 + r[1, 0] * y1 + r[2, 0] * y2 + centroid[0]
    q1 = r[0, 1] * y0 + r[1, 1] * y1 + r[2, 1] * y2 + centroid[1]
    q2 = r[0, 2] * y0 + r[1, 2] * y1 + r[2, 2] * y2 + centroid[2]
    return q0, q1, q2


@njit(cache=True, nogil=True, inline="always")
def turn_back(r: Array, directions: Array, n: int) -> Vector:
    """Row n of directions (m, 3), rotated as by `carry_back`."""
    d0 = r[0, 0] * directions[n, 0] + r[1, 0] * directions[n, 1] + r[2, 0] * directions[n, 2]
    d1 = r[0, 1] * directions[n, 0] + r[1, 1] * directions[n, 1] + r[2, 1] * directions[n, 2]
    d2 = r[0, 2] * directions[n, 0] + r[1, 2] * directions[n, 1] + r[2, 2] * directions[n, 2]
    return d0, d1, d2


@njit(cache=True, nogil=True, inline="always")
def fill_jacobian_row(x: Array, r: Array, centroid: Array, points: Array, n: int, gradient: Vector, row: Array) -> None:
    """Fills `row` (6,), a residual's derivative by the correction, perturbed on the left by a small rotation vector.

    `gradient` is the residual's derivative by row n of points (m, 3) as carried back.
    """
    g0 = r[0, 0] * gradient[0] + r[0, 1] * gradient[1] + r[0, 2] * gradient[2]
    g1 = r[1, 0] * gradient[0] + r[1, 1] * gradient[1] + r[1, 2] * gradient[2]
    g2 = r[2, 0] * gradient[0] + r[2, 1] * gradient[1] + r[2, 2] * gradient[2]
    y0 = points[n, 0] - centroid[0] - x[3]
    y1 = points[n, 1] - centroid[1] - x[4]
    y2 = points[n, 2] - centroid[2] - x[5]
    row[0], row[1], row[2] = g1 * y2 - g2 * y1, g2 * y0 - g0 * y2, g0 * y1 - g1 * y0
    row[3], row[4], row[5] = -g0, -g1, -g2
