"""The places on triangles that are closest to points.

C. Ericson, "Real-time collision detection", 2005, section 5.1.5: which corner, edge or face a point is nearest to is
told by the signs of its barycentric coordinates.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch_simulation.bvh.tree import MAX_DEPTH, Tree

Vector = tuple[float, float, float]


@njit(cache=True, nogil=True)
def find_closest(points: Array, tree: Tree) -> tuple[Array, NDArray[np.int64]]:
    """The closest places (n, 3) and their faces (n,)."""
    inner = len(tree.lower) // 2
    n = len(points)
    places, faces = np.empty((n, 3)), np.empty(n, np.int64)
    stack, gaps = np.empty(MAX_DEPTH, np.int64), np.empty(MAX_DEPTH)
    for r in range(n):
        point = points[r, 0], points[r, 1], points[r, 2]
        nearest, met, place = np.inf, -1, point
        stack[0], gaps[0], height = 0, 0.0, 1
        while height > 0:
            height -= 1
            box = stack[height]
            if gaps[height] >= nearest:
                continue
            leaf = box - inner
            if leaf >= 0:
                for i in range(tree.starts[leaf], tree.starts[leaf + 1]):
                    candidate = _closest_on_triangle(tree.corners, i, point)
                    gap = _squared(_minus(point, candidate))
                    if gap < nearest:
                        nearest, met, place = gap, i, candidate
                continue
            near, far = 2 * box + 1, 2 * box + 2
            near_gap, far_gap = _squared_gap(tree, near, point), _squared_gap(tree, far, point)
            if far_gap < near_gap:
                near, far, near_gap, far_gap = far, near, far_gap, near_gap
            stack[height], gaps[height] = far, far_gap
            stack[height + 1], gaps[height + 1] = near, near_gap
            height += 2
        places[r, 0], places[r, 1], places[r, 2] = place
        faces[r] = tree.faces[met]
    return places, faces


@njit(cache=True, nogil=True)
def _squared_gap(tree: Tree, box: int, point: Vector) -> float:
    total = 0.0
    for axis in range(3):
        gap = max(tree.lower[box, axis] - point[axis], 0.0, point[axis] - tree.upper[box, axis])
        total += gap * gap
    return total


@njit(cache=True, nogil=True)
def _closest_on_triangle(corners: Array, i: int, point: Vector) -> Vector:
    a = corners[i, 0, 0], corners[i, 0, 1], corners[i, 0, 2]
    b = corners[i, 1, 0], corners[i, 1, 1], corners[i, 1, 2]
    c = corners[i, 2, 0], corners[i, 2, 1], corners[i, 2, 2]
    ab, ac, bc = _minus(b, a), _minus(c, a), _minus(c, b)
    ap, bp, cp = _minus(point, a), _minus(point, b), _minus(point, c)
    ab_ap, ac_ap, ab_bp, ac_bp = _dot(ab, ap), _dot(ac, ap), _dot(ab, bp), _dot(ac, bp)
    ab_cp, ac_cp = _dot(ab, cp), _dot(ac, cp)
    if ab_ap <= 0 and ac_ap <= 0:
        return a
    if ab_bp >= 0 and ac_bp <= ab_bp:
        return b
    if ac_cp >= 0 and ab_cp <= ac_cp:
        return c
    of_c = ab_ap * ac_bp - ab_bp * ac_ap
    of_b = ab_cp * ac_ap - ab_ap * ac_cp
    of_a = ab_bp * ac_cp - ab_cp * ac_bp
    if of_c <= 0 and ab_ap >= 0 and ab_bp <= 0:
        return _along(a, ab, _share(ab_ap, ab_ap - ab_bp))
    if of_b <= 0 and ac_ap >= 0 and ac_cp <= 0:
        return _along(a, ac, _share(ac_ap, ac_ap - ac_cp))
    if of_a <= 0 and ac_bp >= ab_bp and ab_cp >= ac_cp:
        return _along(b, bc, _share(ac_bp - ab_bp, (ac_bp - ab_bp) + (ab_cp - ac_cp)))
    total = of_a + of_b + of_c
    return _along(_along(a, ab, _share(of_b, total)), ac, _share(of_c, total))


@njit(cache=True, nogil=True, inline="always")
def _share(part: float, whole: float) -> float:
    """0 on an edge without length."""
    return part / whole if whole > 0 else 0.0


@njit(cache=True, nogil=True, inline="always")
def _along(start: Vector, way: Vector, share: float) -> Vector:
    return start[0] + share * way[0], start[1] + share * way[1], start[2] + share * way[2]


@njit(cache=True, nogil=True, inline="always")
def _minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@njit(cache=True, nogil=True, inline="always")
def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, nogil=True, inline="always")
def _squared(a: Vector) -> float:
    return _dot(a, a)
