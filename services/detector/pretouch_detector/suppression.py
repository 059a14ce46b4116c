"""Non-maximum suppression: of two regions that overlap much only the better is kept."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from pretouch.geometry import Array
from pretouch_detector.overlap import compute_intersection_over_union

MAX_OVERLAP = 0.6
"""Exact intersection over union of two regions above which only the better is proposed."""


def suppress_overlapping(ranked: ArrayLike, count: int) -> list[int]:
    """Which of the rectangles are kept: the best, then each that overlaps no better one by more than MAX_OVERLAP.

    Args:
        ranked: (n, 5) as [x, y, w, h, theta], the best first.
        count: the largest number to keep.

    Returns:
        Their indices, the best first.
    """
    kept: list[int] = _suppress(np.ascontiguousarray(ranked, dtype=np.float64).reshape(-1, 5), count).tolist()
    return kept


@njit(cache=True, nogil=True)
def _suppress(ranked: Array, count: int) -> NDArray[np.int64]:
    kept = np.empty(min(count, len(ranked)), np.int64)
    number = 0
    for k in range(len(ranked)):
        if number == count:
            break
        differs = True
        for j in range(number):
            if compute_intersection_over_union(ranked[k], ranked[kept[j]]) > MAX_OVERLAP:
                differs = False
                break
        if differs:
            kept[number] = k
            number += 1
    return kept[:number]
