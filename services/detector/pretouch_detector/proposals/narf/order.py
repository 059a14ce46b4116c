"""Sorting as in the C++ standard library, ties included.

Depth is quantised, so that neighbours at exactly the same distance are common. Their order affects the last bits of a
running covariance, and thereby sometimes the bin of a direction. To agree with PCL to the bit, ties are sorted as by
libstdc++, with which Debian builds it: partition about a median of three while more than 16 numbers are left, then
insertion sort.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch_detector.proposals.narf.range_image import Floats

_FEW = 16


@njit(cache=True, nogil=True, error_model="numpy")
def sort(keys: Floats, items: NDArray[np.int64], count: int) -> None:
    """Sorts the first `count` of `keys`, rising, and `items` with them."""
    ends = np.empty(count + 1, np.int64)
    low, open = 0, 1
    ends[0] = count
    while open > 0:
        high = ends[open - 1]
        if high - low > _FEW:
            ends[open] = _partition(keys, items, low, high)
            open += 1
        else:
            low = high
            open -= 1
    for k in range(1, count):
        key, item, place = keys[k], items[k], k
        while place > 0 and keys[place - 1] > key:
            keys[place], items[place] = keys[place - 1], items[place - 1]
            place -= 1
        keys[place], items[place] = key, item


@njit(cache=True, nogil=True, error_model="numpy")
def _partition(keys: Floats, items: NDArray[np.int64], low: int, high: int) -> int:
    """Partitions keys[low:high] about the median of its second, middle and last; returns where the larger begin."""
    a, b, c = low + 1, low + (high - low) // 2, high - 1
    if keys[a] < keys[b]:
        median = b if keys[b] < keys[c] else (c if keys[a] < keys[c] else a)
    else:
        median = a if keys[a] < keys[c] else (c if keys[b] < keys[c] else b)
    _swap(keys, items, low, median)
    left, right = low + 1, high
    while True:
        while keys[left] < keys[low]:
            left += 1
        right -= 1
        while keys[low] < keys[right]:
            right -= 1
        if left >= right:
            return left
        _swap(keys, items, left, right)
        left += 1


@njit(cache=True, nogil=True, error_model="numpy")
def _swap(keys: Floats, items: NDArray[np.int64], a: int, b: int) -> None:
    keys[a], keys[b] = keys[b], keys[a]
    items[a], items[b] = items[b], items[a]
