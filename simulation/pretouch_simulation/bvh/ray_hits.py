"""Rays against triangles, watertight: no ray passes between two triangles that share an edge.

S. Woop, C. Benthin, I. Wald, "Watertight ray/triangle intersection", 2013: the corners are sheared so that the ray runs
along an axis; the edge functions of a shared edge then are each other's negatives, to the bit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch_simulation.bvh.tree import MAX_DEPTH, Tree

Vector = tuple[float, float, float]


class _Shear(NamedTuple):
    """What turns a ray onto the z axis and makes it a unit long.

    Attributes:
        x, y, z: the axes in a right-handed order, z being the one that the ray runs along most.
        per_x, per_y: how far it runs along x and y for each unit along z.
        per_z: its lengths for each unit along z.
    """

    x: int
    y: int
    z: int
    per_x: float
    per_y: float
    per_z: float


@njit(cache=True, nogil=True, error_model="numpy")
def find_hits(origins: Array, directions: Array, tree: Tree) -> tuple[Array, NDArray[np.int64]]:
    """Distances (n,) in lengths of the direction, inf = nothing, and faces (n,), -1 = nothing."""
    inner = len(tree.lower) // 2
    n = len(origins)
    distances, faces = np.full(n, np.inf), np.full(n, -1)
    stack, entries = np.empty(MAX_DEPTH, np.int64), np.empty(MAX_DEPTH)
    for r in range(n):
        origin = origins[r, 0], origins[r, 1], origins[r, 2]
        inverse = 1.0 / directions[r, 0], 1.0 / directions[r, 1], 1.0 / directions[r, 2]
        entry = _entry(tree, 0, origin, inverse, np.inf)
        if entry == np.inf:
            continue
        shear = _shear_of(directions[r, 0], directions[r, 1], directions[r, 2])
        nearest, met = np.inf, -1
        stack[0], entries[0], height = 0, entry, 1
        while height > 0:
            height -= 1
            box = stack[height]
            if entries[height] >= nearest:
                continue
            leaf = box - inner
            if leaf >= 0:
                for i in range(tree.starts[leaf], tree.starts[leaf + 1]):
                    distance = _distance(tree.corners, i, origin, shear)
                    if 0.0 < distance < nearest:
                        nearest, met = distance, i
                continue
            near, far = 2 * box + 1, 2 * box + 2
            near_entry = _entry(tree, near, origin, inverse, nearest)
            far_entry = _entry(tree, far, origin, inverse, nearest)
            if far_entry < near_entry:
                near, far, near_entry, far_entry = far, near, far_entry, near_entry
            if far_entry < np.inf:
                stack[height], entries[height] = far, far_entry
                height += 1
            if near_entry < np.inf:
                stack[height], entries[height] = near, near_entry
                height += 1
        if met >= 0:
            distances[r], faces[r] = nearest, tree.faces[met]
    return distances, faces


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _shear_of(dx: float, dy: float, dz: float) -> _Shear:
    ax, ay, az = abs(dx), abs(dy), abs(dz)
    if ax >= ay and ax >= az:
        return _Shear(1, 2, 0, dy / dx, dz / dx, 1.0 / dx)
    if ay >= az:
        return _Shear(2, 0, 1, dz / dy, dx / dy, 1.0 / dy)
    return _Shear(0, 1, 2, dx / dz, dy / dz, 1.0 / dz)


@njit(cache=True, nogil=True, error_model="numpy")
def _entry(tree: Tree, box: int, origin: Vector, inverse: Vector, nearest: float) -> float:
    """Where a ray enters a box, 0 inside; inf: not before `nearest`. Along a side a bound is NaN, and ignored."""
    near, far = 0.0, nearest
    for axis in range(3):
        a = (tree.lower[box, axis] - origin[axis]) * inverse[axis]
        b = (tree.upper[box, axis] - origin[axis]) * inverse[axis]
        if a > b:
            a, b = b, a
        if a > near:
            near = a
        if b < far:
            far = b
    return near if near <= far else np.inf


@njit(cache=True, nogil=True, error_model="numpy")
def _distance(corners: Array, i: int, origin: Vector, shear: _Shear) -> float:
    """To triangle `i`, perhaps behind the origin; NaN: the ray misses it, or runs in its plane."""
    x, y, z = shear.x, shear.y, shear.z
    az, bz, cz = corners[i, 0, z] - origin[z], corners[i, 1, z] - origin[z], corners[i, 2, z] - origin[z]
    ax, ay = corners[i, 0, x] - origin[x] - shear.per_x * az, corners[i, 0, y] - origin[y] - shear.per_y * az
    bx, by = corners[i, 1, x] - origin[x] - shear.per_x * bz, corners[i, 1, y] - origin[y] - shear.per_y * bz
    cx, cy = corners[i, 2, x] - origin[x] - shear.per_x * cz, corners[i, 2, y] - origin[y] - shear.per_y * cz
    u, v, w = cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax
    if (u < 0 or v < 0 or w < 0) and (u > 0 or v > 0 or w > 0):
        return np.nan
    return float((u * az + v * bz + w * cz) / (u + v + w) * shear.per_z)
