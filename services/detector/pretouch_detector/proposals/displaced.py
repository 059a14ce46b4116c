"""What scans leave of the prior when the object is not where the camera puts it: the compiled part of `information`."""

from __future__ import annotations

import numpy as np
from numba import njit

from pretouch.geometry import Array


def warm_up() -> None:
    """Compiles the kernel, which is kept beside the package or in NUMBA_CACHE_DIR."""
    one = np.ones((1, 1))
    mean_covariance(np.ones((1, 1, 6)), np.zeros(2), 1.0, np.zeros((1, 1, 2)), one[0], np.zeros((1, 3)), np.eye(6))


@njit(cache=True, nogil=True)
def mean_covariance(
    rows: Array, corner: Array, cell: float, paths: Array, independent: Array, shifts: Array, precision: Array
) -> Array:
    """(n, 6, 6): the mean over the displacements of what scans along paths (n, b, 2), m, leave.

    Args:
        rows: (nx, ny, 6), see `information._rows`.
        independent: (n,), beams that each one of a path is worth.
        shifts: (t, 3), m and rad: the displacements.
        precision: (6, 6), the prior's.
    """
    total = np.zeros((len(paths), 6, 6))
    information = np.empty((6, 6))
    nx, ny = rows.shape[:2]
    for t in range(len(shifts)):
        cosine, sine = np.cos(shifts[t, 2]), np.sin(shifts[t, 2])
        for k in range(len(paths)):
            information[:] = 0.0
            for i in range(paths.shape[1]):
                x, y = paths[k, i, 0] - shifts[t, 0], paths[k, i, 1] - shifts[t, 1]
                column = min(max(int(np.rint((cosine * x + sine * y - corner[0]) / cell)), 0), nx - 1)
                line = min(max(int(np.rint((cosine * y - sine * x - corner[1]) / cell)), 0), ny - 1)
                row = rows[column, line]
                for a in range(6):
                    for b in range(a + 1):
                        information[a, b] += row[a] * row[b]
            for a in range(6):
                for b in range(a + 1):
                    information[a, b] = information[a, b] * independent[k] + precision[a, b]
                    information[b, a] = information[a, b]
            _invert(information)
            total[k] += information
    return total / len(shifts)


@njit(cache=True, nogil=True)
def _invert(matrix: Array) -> None:
    """Inverts a symmetric positive definite matrix (n, n) in place, by Gauss and Jordan."""
    n = len(matrix)
    for k in range(n):
        pivot = matrix[k, k]
        matrix[k, k] = 1.0
        for j in range(n):
            matrix[k, j] /= pivot
        for i in range(n):
            if i != k:
                factor = matrix[i, k]
                matrix[i, k] = 0.0
                for j in range(n):
                    matrix[i, j] -= factor * matrix[k, j]
