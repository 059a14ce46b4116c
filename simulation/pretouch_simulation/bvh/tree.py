"""A balanced tree of boxes around triangles.

Each box is halved at its triangles' median along the axis that leaves the halves with the least surface, since rays
meet a box in proportion to that (J. Goldsmith, J. Salmon, "Automatic creation of object hierarchies for ray tracing",
1987). All boxes of a level are halved at once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pretouch.geometry import Array

MAX_DEPTH = 64
"""More levels than a tree can have."""
_LEAF = 4
"""Triangles in a leaf, at most."""
_PADDING = 1e-9
"""Of the largest coordinate: boxes are this much larger, far more than the rounding of a ray's entry into them."""


class Tree(NamedTuple):
    """Boxes around triangles; the root is box 0, the children of box k are 2 k + 1 and 2 k + 2, the leaves come last.

    Attributes:
        lower, upper: (k, 3), the boxes' corners.
        starts: (leaves + 1,) the first triangle of each leaf, and the end of the last.
        corners: (m, 3, 3) of the triangles, in the order of the leaves.
        faces: (m,) the index that the caller knows each triangle by.
    """

    lower: Array
    upper: Array
    starts: NDArray[np.int64]
    corners: Array
    faces: NDArray[np.int64]


def build_tree(corners: Array) -> Tree:
    """The tree over triangles (m, 3, 3), m > 0."""
    low, high = corners.min(axis=1), corners.max(axis=1)
    centres, faces, starts = low + high, np.arange(len(corners)), np.array([0, len(corners)])
    while np.diff(starts).max() > _LEAF:
        boxes = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
        sorted_along = np.array([faces[np.lexsort((centres[faces, axis], boxes))] for axis in range(3)])
        starts = np.sort(np.concatenate([starts, (starts[:-1] + starts[1:]) // 2]))
        surfaces = [_surfaces(low[order], high[order], starts).reshape(-1, 2).sum(axis=1) for order in sorted_along]
        faces = np.choose(np.argmin(surfaces, axis=0)[boxes], sorted_along)
    padding = _PADDING * np.abs(corners).max()
    lower = [np.minimum.reduceat(low[faces], starts[:-1]) - padding]
    upper = [np.maximum.reduceat(high[faces], starts[:-1]) + padding]
    while len(lower[0]) > 1:
        lower.insert(0, np.minimum(lower[0][::2], lower[0][1::2]))
        upper.insert(0, np.maximum(upper[0][::2], upper[0][1::2]))
    return Tree(np.concatenate(lower), np.concatenate(upper), starts, corners[faces], faces)


def _surfaces(low: Array, high: Array, starts: NDArray[np.int64]) -> Array:
    """Half the surfaces of the boxes around the triangles from each start to the next."""
    sides = np.maximum.reduceat(high, starts[:-1]) - np.minimum.reduceat(low, starts[:-1])
    return np.asarray(sides[:, 0] * sides[:, 1] + sides[:, 1] * sides[:, 2] + sides[:, 2] * sides[:, 0])
