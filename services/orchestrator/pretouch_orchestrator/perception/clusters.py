"""Pixels that hang together: neighbours in the image without a jump in depth between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from pretouch_orchestrator.perception.table import depth_std

_NEIGHBOURS = ((0, 1), (1, 0), (1, 1), (1, -1))
_MIN_SUPPORT = 3
"""A pixel that fewer of its eight neighbours stand by is a flying one."""
_SPECK = 4e-4
"""m^2 facing the camera: less than 2 cm x 2 cm that no surface beside it holds up is not believed."""


def depth_jump(z: NDArray[np.float32]) -> NDArray[np.float64]:
    """m: two neighbouring depths of one surface at z differ by less than this: steep faces and noise do not part it."""
    return np.asarray(np.maximum(0.03, 6 * depth_std(z)), dtype=np.float64)


def joined_neighbours(
    depth: NDArray[np.float32], pixels: NDArray[np.bool_]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Flat indices (m,), (m,) of 8-neighbours within `pixels` (h, w) without a depth jump between, each pair once."""
    h, w = depth.shape
    index = np.arange(h * w).reshape(h, w)
    firsts, seconds = [], []
    for dv, du in _NEIGHBOURS:
        a = np.s_[: h - dv, max(0, -du) : w - max(0, du)]
        b = np.s_[dv:, max(0, du) : w + min(0, du)]
        together = pixels[a] & pixels[b]
        together &= np.abs(depth[a] - depth[b]) < depth_jump(np.minimum(depth[a], depth[b]))
        firsts.append(index[a][together])
        seconds.append(index[b][together])
    return np.concatenate(firsts), np.concatenate(seconds)


def without_flying(depth: NDArray[np.float32], pixels: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """`pixels` (h, w) less those that fewer than three of their eight neighbours stand by."""
    first, second = joined_neighbours(depth, pixels)
    support = np.bincount(first, minlength=depth.size) + np.bincount(second, minlength=depth.size)
    return pixels & (support.reshape(depth.shape) >= _MIN_SUPPORT)


def clusters(depth: NDArray[np.float32], pixels: NDArray[np.bool_]) -> NDArray[np.intp]:
    """(h, w): the cluster of each pixel, 0 outside `pixels`, 1 for the largest cluster, 2 for the next, ..."""
    first, second = joined_neighbours(depth, pixels)
    members = np.flatnonzero(pixels)
    place = np.zeros(depth.size, dtype=np.intp)
    place[members] = np.arange(len(members))
    links = coo_array((np.ones(len(first), dtype=bool), (place[first], place[second])), shape=(len(members),) * 2)
    _, parts = connected_components(links, directed=False)
    sizes = np.bincount(parts) if len(members) else np.zeros(0, dtype=np.intp)
    rank = np.empty(len(sizes), dtype=np.intp)
    rank[np.argsort(-sizes, kind="stable")] = np.arange(1, len(sizes) + 1)
    labels = np.zeros(depth.size, dtype=np.intp)
    labels[members] = rank[parts]
    return labels.reshape(depth.shape)


def specks(depth: NDArray[np.float32], focal: float) -> NDArray[np.bool_]:
    """(h, w) True on clusters too small to stand there: what a depth camera makes up in mid-air; `focal` in px."""
    labels = clusters(depth, depth > 0)
    area = np.bincount(labels.ravel(), weights=(np.square(depth, dtype=np.float64) / focal**2).ravel())
    small = area < _SPECK
    small[0] = False
    return np.asarray(small[labels], dtype=bool)
