"""A depth image seen from above the table: the compiled part of `map_relief`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch.geometry import Array


class Grid(NamedTuple):
    """Square cells over the table.

    Attributes:
        corner: (2,), m, the place of cell (0, 0).
        cell: m, a cell's side.
        shape: (nx, ny) cells.
    """

    corner: Array
    cell: float
    shape: tuple[int, int]


@njit(cache=True, nogil=True)
def project_from_above(
    depth: NDArray[np.float32],
    mask: NDArray[np.bool_],
    camera: Array,
    turn: Array,
    shift: Array,
    band: float,
    grid: Grid,
) -> tuple[Array, Array, Array]:
    """Where each pixel's point lies over the table, and how high object and table reach over each cell of a grid.

    Args:
        depth: (h, w), m; 0 where there is none.
        mask: (h, w), the object.
        camera: (4,), fx, fy, cx, cy, px.
        turn, shift: (3, 3) and (3,), m: from the camera's frame to the table's, whose z is the height.
        band: m from the table's plane within which a pixel beside the object shows the table.
        grid: what lies beside it is left out.

    Returns:
        places (h, w, 2), m, NaN where neither object nor table; the highest of the object's points over each cell
        (nx, ny), m, and of the table's, -inf without one.
    """
    fx, fy, cx, cy = camera
    corner, cell, shape = grid
    places = np.full((*depth.shape, 2), np.nan)
    top, ground = np.full(shape, -np.inf), np.full(shape, -np.inf)
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            z = np.float64(depth[v, u])
            if z <= 0.0:
                continue
            x, y = (u - cx) * z / fx, (v - cy) * z / fy
            height = turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * z + shift[2]
            if not mask[v, u] and abs(height) >= band:
                continue
            p = turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * z + shift[0]
            q = turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * z + shift[1]
            places[v, u, 0], places[v, u, 1] = p, q
            i, j = int(np.rint((p - corner[0]) / cell)), int(np.rint((q - corner[1]) / cell))
            if 0 <= i < shape[0] and 0 <= j < shape[1]:
                heights = top if mask[v, u] else ground
                heights[i, j] = max(heights[i, j], height)
    return places, top, ground
