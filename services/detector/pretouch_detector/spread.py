"""Regions that differ: of two that overlap much only the better is kept."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from pretouch.geometry import Array
from pretouch_detector.overlap import share

MAX_OVERLAP = 0.6
"""Intersection over union of regions that are proposed."""


def spread(ranked: ArrayLike, count: int, limit: float = MAX_OVERLAP) -> list[int]:
    """Which of the rectangles are kept: the best, then each that overlaps no better one too much.

    Args:
        ranked: (n, 5) as [x, y, w, h, theta], the best first.
        count: as many at most.
        limit: intersection over union, exact, above which it is too much.

    Returns:
        Their indices, the best first.
    """
    kept: list[int] = _kept(np.ascontiguousarray(ranked, dtype=np.float64).reshape(-1, 5), count, limit).tolist()
    return kept


@njit(cache=True, nogil=True)
def _kept(ranked: Array, count: int, limit: float) -> NDArray[np.int64]:
    kept = np.empty(min(count, len(ranked)), np.int64)
    number = 0
    for k in range(len(ranked)):
        if number == count:
            break
        differs = True
        for j in range(number):
            if share(ranked[k], ranked[kept[j]]) > limit:
                differs = False
                break
        if differs:
            kept[number] = k
            number += 1
    return kept[:number]
