"""The least squares rigid motion of corresponding points, in closed form."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch.geometry import Array

_SWEEPS = 12


@njit(cache=True, nogil=True)
def compute_rotation(s: Array) -> Array:
    """R (3, 3) that maximises trace(R s), s (3, 3) = sum of (p - mean p) (q - mean q)^T: the best rotation from p to q.

    Horn, "Closed-form solution of absolute orientation using unit quaternions" (JOSA A 1987): the eigenvector of the
    largest eigenvalue of a symmetric 4x4 matrix, found by Jacobi rotations. It is always a proper rotation.
    """
    m = np.empty((4, 4))
    m[0, 0] = s[0, 0] + s[1, 1] + s[2, 2]
    m[1, 1] = s[0, 0] - s[1, 1] - s[2, 2]
    m[2, 2] = s[1, 1] - s[0, 0] - s[2, 2]
    m[3, 3] = s[2, 2] - s[0, 0] - s[1, 1]
    m[0, 1] = m[1, 0] = s[1, 2] - s[2, 1]
    m[0, 2] = m[2, 0] = s[2, 0] - s[0, 2]
    m[0, 3] = m[3, 0] = s[0, 1] - s[1, 0]
    m[1, 2] = m[2, 1] = s[0, 1] + s[1, 0]
    m[1, 3] = m[3, 1] = s[2, 0] + s[0, 2]
    m[2, 3] = m[3, 2] = s[1, 2] + s[2, 1]
    vectors = np.eye(4)
    size = 0.0
    for a in range(4):
        for b in range(4):
            size += m[a, b] * m[a, b]
    for _ in range(_SWEEPS):
        off = m[0, 1] ** 2 + m[0, 2] ** 2 + m[0, 3] ** 2 + m[1, 2] ** 2 + m[1, 3] ** 2 + m[2, 3] ** 2
        if off <= 1e-30 * size:
            break
        for a in range(3):
            for b in range(a + 1, 4):
                if m[a, b] * m[a, b] <= 1e-34 * size:
                    continue
                theta = (m[b, b] - m[a, a]) / (2.0 * m[a, b])
                t = 1.0 / (abs(theta) + np.sqrt(theta * theta + 1.0))
                if theta < 0:
                    t = -t
                c = 1.0 / np.sqrt(t * t + 1.0)
                sine = t * c
                for k in range(4):
                    p, q = m[k, a], m[k, b]
                    m[k, a], m[k, b] = c * p - sine * q, sine * p + c * q
                for k in range(4):
                    p, q = m[a, k], m[b, k]
                    m[a, k], m[b, k] = c * p - sine * q, sine * p + c * q
                    p, q = vectors[k, a], vectors[k, b]
                    vectors[k, a], vectors[k, b] = c * p - sine * q, sine * p + c * q
    top = 0
    for a in range(1, 4):
        if m[a, a] > m[top, top]:
            top = a
    w, x, y, z = vectors[0, top], vectors[1, top], vectors[2, top], vectors[3, top]
    r = np.empty((3, 3))
    r[0, 0], r[0, 1], r[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    r[1, 0], r[1, 1], r[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    r[2, 0], r[2, 1], r[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    return r


@njit(cache=True, nogil=True)
def fit_rigid_motion(
    source: Array, points: Array, neighbour: NDArray[np.int32], kept: NDArray[np.bool_], r: Array, t: Array
) -> None:
    """Least squares rigid motion of the kept source points (n, 3) onto their neighbours among `points` (m, 3), m.

    Fills r (3, 3) and t (3,): neighbour = r source + t.
    """
    n = 0
    a, b = np.zeros(3), np.zeros(3)
    for i in range(source.shape[0]):
        if kept[i]:
            n += 1
            for k in range(3):
                a[k] += source[i, k]
                b[k] += points[neighbour[i], k]
    for k in range(3):
        a[k] /= n
        b[k] /= n
    s = np.zeros((3, 3))
    for i in range(source.shape[0]):
        if kept[i]:
            for j in range(3):
                p = source[i, j] - a[j]
                for k in range(3):
                    s[j, k] += p * (points[neighbour[i], k] - b[k])
    r[:] = compute_rotation(s)
    for j in range(3):
        t[j] = b[j] - r[j, 0] * a[0] - r[j, 1] * a[1] - r[j, 2] * a[2]


@njit(cache=True, nogil=True)
def apply_motion(r: Array, t: Array, source: Array, moved: Array) -> None:
    """Fills `moved` (n, 3) with r source + t."""
    for i in range(source.shape[0]):
        x, y, z = source[i, 0], source[i, 1], source[i, 2]
        for k in range(3):
            moved[i, k] = r[k, 0] * x + r[k, 1] * y + r[k, 2] * z + t[k]
