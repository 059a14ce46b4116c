"""Triangles that rays and points are tested against."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pretouch.geometry import Array
from pretouch_simulation.bvh.closest_points import find_closest
from pretouch_simulation.bvh.ray_hits import find_hits
from pretouch_simulation.bvh.tree import build_tree

NO_FACE = -1


class Triangles:
    """Triangles, ready to be searched.

    Args:
        vertices: (n, 3), in any unit.
        faces: (m, 3) indices into `vertices`, m > 0; faces without area are never hit.
    """

    def __init__(self, vertices: ArrayLike, faces: ArrayLike) -> None:
        self._corners = np.asarray(vertices, dtype=np.float64)[np.asarray(faces, dtype=np.int64)]
        self._tree = build_tree(self._corners)

    @cached_property
    def normals(self) -> Array:
        """(m, 3) unit, counter-clockwise corners seen against them; zero for a face without area."""
        a, b, c = self._corners[:, 0], self._corners[:, 1], self._corners[:, 2]
        normals = np.cross(b - a, c - a)
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        return np.asarray(np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0))

    def cast(self, origins: ArrayLike, directions: ArrayLike) -> tuple[Array, NDArray[np.int64]]:
        """Where rays from `origins` (n, 3) in `directions` (n, 3) first meet a face, from either side.

        Returns:
            Distances (n,) in lengths of the direction, above 0, inf = nothing; faces (n,), `NO_FACE` = nothing.
        """
        return find_hits(_rows(origins), _rows(directions), self._tree)

    def closest(self, points: ArrayLike) -> tuple[Array, NDArray[np.int64]]:
        """The places (n, 3) on the faces that are closest to `points` (n, 3), and their faces (n,)."""
        return find_closest(_rows(points), self._tree)


def _rows(vectors: ArrayLike) -> Array:
    """(n, 3), of the one kind of array that the kernels are compiled for."""
    return np.require(vectors, np.float64, ["C", "W"]).reshape(-1, 3)
