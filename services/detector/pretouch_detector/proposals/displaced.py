"""What scans leave of the prior when the object is not where the camera puts it: a compiled part of `information`."""

from __future__ import annotations

import numpy as np
from numba import njit

from pretouch.geometry import Array

_TERMS = 21
"""Entries of a symmetric (6, 6)'s lower triangle, row by row."""


def warm_up() -> None:
    """Compiles the kernel, which is kept beside the package or in NUMBA_CACHE_DIR."""
    one = np.ones((1, 1))
    mean_square(
        np.ones((1, 1, 6)), np.zeros(2), 1.0, np.zeros((1, 1, 2)), one[0], np.zeros((1, 3)), np.eye(6), np.eye(6)
    )


@njit(cache=True, nogil=True)
def mean_square(
    rows: Array, corner: Array, cell: float, paths: Array, independent: Array, shifts: Array, precision: Array,
    lever: Array,
) -> Array:  # fmt: skip
    """(n,): trace(lever^T C lever), the mean over displacements, of the covariances C left along paths (n, b, 2), m.

    Args:
        rows: (nx, ny, 6), see `information._rows`.
        independent: (n,), beams that each one of a path is worth.
        shifts: (t, 3), m and rad: the displacements.
        precision: (6, 6), the prior's.
        lever: (6, 6).
    """
    nx, ny = rows.shape[:2]
    products = np.empty((nx, ny, _TERMS))
    for u in range(nx):
        for v in range(ny):
            k = 0
            for a in range(6):
                for b in range(a + 1):
                    products[u, v, k] = rows[u, v, a] * rows[u, v, b]
                    k += 1
    told, matrix = np.empty(_TERMS), np.empty((6, 6))
    total = np.zeros(len(paths))
    for t in range(len(shifts)):
        cosine, sine = np.cos(shifts[t, 2]), np.sin(shifts[t, 2])
        for n in range(len(paths)):
            told[:] = 0.0
            for i in range(paths.shape[1]):
                x, y = paths[n, i, 0] - shifts[t, 0], paths[n, i, 1] - shifts[t, 1]
                column = min(max(int(np.rint((cosine * x + sine * y - corner[0]) / cell)), 0), nx - 1)
                line = min(max(int(np.rint((cosine * y - sine * x - corner[1]) / cell)), 0), ny - 1)
                for k in range(_TERMS):
                    told[k] += products[column, line, k]
            k = 0
            for a in range(6):
                for b in range(a + 1):
                    matrix[a, b] = told[k] * independent[n] + precision[a, b]
                    k += 1
            total[n] += _trace_of_inverse(matrix, lever)
    return total / len(shifts)


@njit(cache=True, nogil=True)
def _trace_of_inverse(matrix: Array, lever: Array) -> float:
    """trace(lever^T matrix^-1 lever) of a positive definite matrix (6, 6), by Cholesky; its lower triangle is used up.

    With matrix = L L^T it is the sum of the squares of L^-1 lever.
    """
    for a in range(6):
        for b in range(a + 1):
            left = matrix[a, b]
            for k in range(b):
                left -= matrix[a, k] * matrix[b, k]
            matrix[a, b] = np.sqrt(left) if a == b else left / matrix[b, b]
    solved = np.empty(6)
    trace = 0.0
    for column in range(6):
        for a in range(6):
            left = lever[a, column]
            for k in range(a):
                left -= matrix[a, k] * solved[k]
            solved[a] = left / matrix[a, a]
            trace += solved[a] * solved[a]
    return trace
