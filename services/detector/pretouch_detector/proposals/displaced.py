"""The uncertainty after a scan of a displaced object: a compiled part of `information`."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch_detector.proposals.from_above import Grid

_TERMS = 21
"""Entries of a symmetric (6, 6)'s lower triangle, row by row."""


@njit(cache=True, nogil=True)
def average_square_errors(
    rows: Array, grid: Grid, paths: Array, independent: Array, shifts: Array, precision: Array, lever: Array
) -> Array:
    """(n,): the mean over displacements of trace(lever^T C lever), C being the covariance after a scan of a path.

    Args:
        rows: (nx, ny, 6), see `information._linearise_beams`, over the cells of `grid`.
        independent: (n,), independent measurements that each beam of a path counts for.
        shifts: (t, 3), m and rad: the displacements.
        precision: (6, 6), the prior's.
        lever: (6, 6).
        paths: (n, b, 2), m.
    """
    nx, ny = grid.shape
    products = np.empty((nx * ny, _TERMS))
    for u in range(nx):
        for v in range(ny):
            k = 0
            for a in range(6):
                for b in range(a + 1):
                    products[u * ny + v, k] = rows[u, v, a] * rows[u, v, b]
                    k += 1
    met = np.empty(paths.shape[1], np.int64)
    information, matrix = np.empty(_TERMS), np.empty((6, 6))
    total = np.zeros(len(paths))
    for n in range(len(paths)):
        for t in range(len(shifts)):
            _find_cells(paths[n], shifts[t], grid, met)
            information[:] = 0.0
            for i in range(len(met)):
                product = products[met[i]]
                for k in range(_TERMS):
                    information[k] += product[k]
            k = 0
            for a in range(6):
                for b in range(a + 1):
                    matrix[a, b] = information[k] * independent[n] + precision[a, b]
                    k += 1
            total[n] += _compute_trace(matrix, lever)
    return total / len(shifts)


@njit(cache=True, nogil=True)
def _find_cells(path: Array, shift: Array, grid: Grid, met: NDArray[np.int64]) -> None:
    """Fills `met` (b,) with the index of the cell that each beam of a path (b, 2), m, hits after the displacement."""
    corner, cell, (nx, ny) = grid
    cosine, sine = np.cos(shift[2]) / cell, np.sin(shift[2]) / cell
    first = 0.5 - cosine * shift[0] - sine * shift[1] - corner[0] / cell
    second = 0.5 + sine * shift[0] - cosine * shift[1] - corner[1] / cell
    for i in range(len(met)):
        x, y = path[i, 0], path[i, 1]
        u = min(max(int(cosine * x + sine * y + first), 0), nx - 1)
        v = min(max(int(cosine * y - sine * x + second), 0), ny - 1)
        met[i] = u * ny + v


@njit(cache=True, nogil=True)
def _compute_trace(matrix: Array, lever: Array) -> float:
    """trace(lever^T matrix^-1 lever) of a positive definite matrix (6, 6); its lower triangle is overwritten.

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
