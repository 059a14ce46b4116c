"""Finds the pixels on a rectangle's perimeter among many."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch.geometry import Array

_TILE = 8
"""px: side of the squares by which pixels are sorted."""
_BLOCK = 32
"""Successive pixels in that order that are excluded together."""
_ROUNDING = 0.01
"""px: an upper bound of the rounding errors in single precision."""


def sort_by_tile(seen: NDArray[np.float32]) -> NDArray[np.int64]:
    """An order (n,) of pixels (n, 2) that keeps near ones together."""
    cells = np.floor(seen / _TILE)
    return np.lexsort((cells[:, 0], cells[:, 1]))


def enclose_blocks(seen: NDArray[np.float32]) -> Array:
    """(t, b, 3): a circle [u, v, radius], px, around each _BLOCK of pixels seen (t, n, 2)."""
    circles = []
    for start in range(0, seen.shape[1], _BLOCK):
        block = seen[:, start : start + _BLOCK].astype(np.float64)
        middle = 0.5 * (block.min(axis=1) + block.max(axis=1))
        radius = np.linalg.norm(block - middle[:, None], axis=2).max(axis=1)
        circles.append(np.column_stack([middle, radius + _ROUNDING]))
    return np.ascontiguousarray(np.stack(circles, axis=1))


@njit(cache=True, nogil=True)
def _distance_from_perimeter(u: float, v: float, box: Array, cosine: float, sine: float) -> float:
    """px: distance of a pixel from the perimeter of `box` (5,)."""
    du, dv = u - box[0], v - box[1]
    a = abs(cosine * du + sine * dv) - 0.5 * box[2]
    b = abs(-sine * du + cosine * dv) - 0.5 * box[3]
    if a <= 0 and b <= 0:
        return min(-a, -b)
    a, b = max(a, 0.0), max(b, 0.0)
    return np.sqrt(a * a + b * b)


@njit(cache=True, nogil=True)
def find_near_perimeter(seen: NDArray[np.float32], box: Array, width: float) -> NDArray[np.int64]:
    """Which pixels seen (n, 2) lie within `width`, px, of the perimeter of `box` (5,)."""
    cosine, sine = np.cos(box[4]), np.sin(box[4])
    found = np.empty(seen.shape[0], np.int64)
    count = 0
    for i in range(seen.shape[0]):
        if _distance_from_perimeter(seen[i, 0], seen[i, 1], box, cosine, sine) <= width:
            found[count] = i
            count += 1
    return found[:count]


@njit(cache=True, nogil=True)
def find_in_blocks(
    seen: NDArray[np.float32], circles: Array, order: NDArray[np.int64], box: Array, width: float
) -> NDArray[np.int64]:
    """As `find_near_perimeter`, for pixels (n, 2) sorted by `order` (n,), with the `circles` (b, 3) of their blocks."""
    cosine, sine = np.cos(box[4]), np.sin(box[4])
    n = seen.shape[0]
    found = np.empty(n, np.int64)
    count = 0
    for b in range(circles.shape[0]):
        if _distance_from_perimeter(circles[b, 0], circles[b, 1], box, cosine, sine) > width + circles[b, 2]:
            continue
        for i in range(b * _BLOCK, min((b + 1) * _BLOCK, n)):
            if _distance_from_perimeter(seen[i, 0], seen[i, 1], box, cosine, sine) <= width:
                found[count] = order[i]
                count += 1
    return np.sort(found[:count])
