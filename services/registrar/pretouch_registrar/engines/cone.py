"""What a wide beam measures: the signal's mean path over its cone, on the surface seen from above.

A time-of-flight module with a field of view answers with one range for all that its cone meets. A patch of surface
counts by the module's response in its direction (half at the cone's edge, a Gaussian), by the cosine of the incidence
and by one over the squared distance (a Lambertian target); the module is calibrated on a perpendicular wall. Where the
camera saw nothing, the surface lies between the table and the sight line above it: the answer is an interval.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch_registrar.engines.camera_model import CELL, FACING, HIGH, LOW, NEARBY

_RINGS = ((0.0, 1), (0.5, 4), (0.85, 5))
"""Radius, as a share of the half angle, and rays of each ring."""
_PACE = 0.006
"""m: step of a ray above the surface."""
_WALL = 0.007
"""m: a ray this far below the surface in one step has met a wall, not a slope."""
_GRAZING = 0.25
"""Cosine of the incidence on a wall."""


def rays_of(half_angle: float) -> Array:
    """(k, 4): each ray's lateral offsets at unit depth (2), its length there, its response on a perpendicular wall.

    The responses sum to 1 when divided by the squared length, so that they are weights.
    """
    rows = []
    edges = [0.0, 0.25, 0.69, 1.0]
    for n, (radius, count) in enumerate(_RINGS):
        angle = radius * half_angle
        turns = 2 * np.pi * (np.arange(count) + 0.5 * (n % 2)) / count
        area = (edges[n + 1] ** 2 - edges[n] ** 2) / count
        for turn in turns:
            tangent = np.tan(angle)
            response = area * np.exp(-np.log(2.0) * radius**2)
            rows.append([tangent * np.cos(turn), tangent * np.sin(turn), 1 / np.cos(angle), response])
    return np.array(rows)


@njit(cache=True, nogil=True, fastmath=True)
def mean_range(
    o0: float, o1: float, o2: float, d0: float, d1: float, d2: float, farthest: float, rays: Array, table: Array,
    footprint: NDArray[np.float32], frame: Array,
) -> tuple[float, float, float]:  # fmt: skip
    """The nearest and farthest mean range, m, that a module at o looking along d may see, and the spread of its paths.

    Paths longer than `farthest` count as that long.
    """
    # the module in the table's axes: x, y along it, z above it
    ox = frame[0] * o0 + frame[1] * o1 + frame[2] * o2 - frame[6]
    oy = frame[3] * o0 + frame[4] * o1 + frame[5] * o2 - frame[7]
    oz = table[0] * o0 + table[1] * o1 + table[2] * o2 - table[3]
    dx = frame[0] * d0 + frame[1] * d1 + frame[2] * d2
    dy = frame[3] * d0 + frame[4] * d1 + frame[5] * d2
    dz = table[0] * d0 + table[1] * d1 + table[2] * d2
    # two axes across the beam; dz is near -1
    s = 1.0 / max(np.sqrt(1.0 - dx * dx), 1e-6)
    ax, ay, az = s * (1.0 - dx * dx), -s * dx * dy, -s * dx * dz
    bx, by, bz = dy * az - dz * ay, dz * ax - dx * az, dx * ay - dy * ax
    nx, ny = footprint.shape[1], footprint.shape[2]
    weight_near = weight_far = sum_near = sum_far = square = wall = wall_path = 0.0
    for k in range(rays.shape[0]):
        u, v, length = rays[k, 0], rays[k, 1], rays[k, 2]
        rx, ry, rz = dx + u * ax + v * bx, dy + u * ay + v * by, dz + u * az + v * bz
        stop = farthest / length
        t = 0.0
        if rz < -1e-6:
            stop = min(stop, oz / -rz)
            i = int((ox + rx * 0.5 * stop) / CELL)
            j = int((oy + ry * 0.5 * stop) / CELL)
            top = 0.0
            if i >= 0 and j >= 0 and i < nx and j < ny:
                top = footprint[NEARBY, i, j]
            t = max(0.0, (oz - top) / -rz - 1e-4)
        near = far = -1.0
        near_facing = far_facing = 1.0
        while t < stop:
            i, j = int((ox + rx * t) / CELL), int((oy + ry * t) / CELL)
            z = oz + rz * t
            if ox + rx * t >= 0 and oy + ry * t >= 0 and i < nx and j < ny:
                if near < 0 and z <= footprint[HIGH, i, j]:
                    deep = footprint[HIGH, i, j] - z
                    if deep > _WALL:
                        near, near_facing = t, _GRAZING
                    else:
                        near, near_facing = t + deep / rz, footprint[FACING, i, j]
                if z <= footprint[LOW, i, j]:
                    deep = footprint[LOW, i, j] - z
                    if deep > _WALL:
                        far, far_facing = t, _GRAZING
                    else:
                        far, far_facing = t + deep / rz, footprint[FACING, i, j]
                    break
            t += _PACE
        if far < 0:
            far = stop
        if near < 0:
            near, near_facing = far, far_facing
        path = max(near, 0.001) * length
        w = rays[k, 3] * near_facing / (path * path)
        weight_near += w
        sum_near += w * path
        path = max(far, 0.001) * length
        w = rays[k, 3] * far_facing / (path * path)
        weight_far += w
        sum_far += w * path
        square += w * path * path
        on_wall = rays[k, 3] / (length * length * length)
        wall += on_wall
        wall_path += on_wall * length
    scale = wall / wall_path
    mean = sum_far / weight_far
    spread = np.sqrt(max(square / weight_far - mean * mean, 0.0))
    return sum_near / weight_near * scale, mean * scale, spread
