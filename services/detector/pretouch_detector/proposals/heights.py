"""The highest points over a grid: the compiled part of `relief`."""

from __future__ import annotations

import numpy as np
from numba import njit

from pretouch.geometry import Array


def warm_up() -> None:
    """Compiles the kernel, which is kept beside the package or in NUMBA_CACHE_DIR."""
    highest(np.zeros((1, 3)), np.zeros(2), 1.0, (1, 1))


@njit(cache=True, nogil=True)
def highest(cloud: Array, corner: Array, cell: float, shape: tuple[int, int]) -> Array:
    """(nx, ny), m: the height of the highest point of `cloud` (n, 3) over each cell; -inf without one.

    Args:
        corner: (2,), m, the place of cell (0, 0).
        cell: m, a cell's side.
        shape: (nx, ny); what lies beside the grid is left out.
    """
    heights = np.full(shape, -np.inf)
    for k in range(len(cloud)):
        i, j = int(np.rint((cloud[k, 0] - corner[0]) / cell)), int(np.rint((cloud[k, 1] - corner[1]) / cell))
        if 0 <= i < shape[0] and 0 <= j < shape[1]:
            heights[i, j] = max(heights[i, j], cloud[k, 2])
    return heights
