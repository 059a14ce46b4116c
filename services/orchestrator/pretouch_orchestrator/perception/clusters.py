"""Connected components of a depth image: neighbouring pixels without a depth discontinuity between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from pretouch.camera import kinect_depth_std

_NEIGHBOURS = ((0, 1), (1, 0), (1, 1), (1, -1))
_MIN_SUPPORT = 3
"""Connected 8-neighbours that a pixel needs not to be a flying pixel."""
_SPECK_AREA = 4e-4
"""m^2 facing the camera: an isolated component smaller than 2 cm x 2 cm is taken for an artefact."""


def depth_jump_threshold(z: NDArray[np.float32]) -> NDArray[np.float64]:
    """m: the least difference of neighbouring depths at z that separates two surfaces, above noise and steep faces."""
    return np.asarray(np.maximum(0.03, 6 * kinect_depth_std(z)), dtype=np.float64)


def find_connected_neighbours(
    depth: NDArray[np.float32], pixels: NDArray[np.bool_]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Flat indices (m,), (m,) of connected 8-neighbours within `pixels` (h, w), each pair once."""
    h, w = depth.shape
    index = np.arange(h * w).reshape(h, w)
    firsts, seconds = [], []
    for dv, du in _NEIGHBOURS:
        a = np.s_[: h - dv, max(0, -du) : w - max(0, du)]
        b = np.s_[dv:, max(0, du) : w + min(0, du)]
        together = pixels[a] & pixels[b]
        together &= np.abs(depth[a] - depth[b]) < depth_jump_threshold(np.minimum(depth[a], depth[b]))
        firsts.append(index[a][together])
        seconds.append(index[b][together])
    return np.concatenate(firsts), np.concatenate(seconds)


def remove_flying_pixels(depth: NDArray[np.float32], pixels: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """`pixels` (h, w) without flying pixels, those connected to fewer than three of their 8-neighbours."""
    first, second = find_connected_neighbours(depth, pixels)
    support = np.bincount(first, minlength=depth.size) + np.bincount(second, minlength=depth.size)
    return pixels & (support.reshape(depth.shape) >= _MIN_SUPPORT)


def label_clusters(depth: NDArray[np.float32], pixels: NDArray[np.bool_]) -> NDArray[np.intp]:
    """(h, w): the label of each pixel's cluster: 0 outside `pixels`, 1 for the largest cluster, 2 for the next, ..."""
    first, second = find_connected_neighbours(depth, pixels)
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


def find_specks(depth: NDArray[np.float32], focal: float) -> NDArray[np.bool_]:
    """(h, w), True on label_clusters too small to be real, which depth cameras make up in mid-air; `focal` in px."""
    labels = label_clusters(depth, depth > 0)
    area = np.bincount(labels.ravel(), weights=(np.square(depth, dtype=np.float64) / focal**2).ravel())
    small = area < _SPECK_AREA
    small[0] = False
    return np.asarray(small[labels], dtype=bool)
