"""A wide beam's range, or its miss, beside what it should measure: the signal's mean path over its cone.

A time-of-flight module with a field of view answers with one range for all that its cone meets, on the surface as seen
from above. A patch of it counts by the module's response in its direction (half at the cone's edge, a Gaussian), by the
cosine of the incidence and by one over the squared distance (a Lambertian target); the module is calibrated on a
perpendicular wall. Where the camera saw nothing, the surface lies between the table and the sight line above it: the
answer is an interval.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pretouch.geometry import Array
from pretouch_registrar.engines.camera_model import CELL
from pretouch_registrar.engines.compiled import NO_REFERENCES
from pretouch_registrar.engines.correction import Vector
from pretouch_registrar.engines.problem import Noise, Target
from pretouch_registrar.engines.rays import Rays
from pretouch_registrar.engines.robust_kernel import CAP_BEHIND, CAP_FRONT, robust_cost

CONE_SPREAD = 0.25
"""Share of the spread of the paths in a cone that its mean may be wrong by."""
_PACE = 0.006
"""m: step of a ray above the surface."""
_WALL = 0.007
"""m: a ray this far below the surface in one step has met a wall, not a slope."""
_GRAZING = 0.25
"""Cosine of the incidence on a wall."""
_SHIFT, _TURN = 0.001, 0.012
"""m and rad: steps of the differences that stand for a wide beam's derivatives."""


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy", **NO_REFERENCES)
def mean_range(
    origin: Vector, direction: Vector, farthest: float, rays: Rays, target: Target
) -> tuple[float, float, float]:
    """The nearest and farthest mean range, m, that a module at `origin` may see, and the spread of its paths.

    Paths longer than `farthest` count as that long.
    """
    o0, o1, o2 = origin
    d0, d1, d2 = direction
    normal, footprint = target.table.normal, target.footprint
    x_axis, y_axis, low, high = footprint.x_axis, footprint.y_axis, footprint.low, footprint.high
    # the module in the table's axes: x, y along it, z above it
    ox = x_axis[0] * o0 + x_axis[1] * o1 + x_axis[2] * o2 - footprint.corner[0]
    oy = y_axis[0] * o0 + y_axis[1] * o1 + y_axis[2] * o2 - footprint.corner[1]
    oz = normal[0] * o0 + normal[1] * o1 + normal[2] * o2 - target.table.offset
    dx = x_axis[0] * d0 + x_axis[1] * d1 + x_axis[2] * d2
    dy = y_axis[0] * d0 + y_axis[1] * d1 + y_axis[2] * d2
    dz = normal[0] * d0 + normal[1] * d1 + normal[2] * d2
    # two axes across the beam; dz is near -1
    s = 1.0 / max(np.sqrt(1.0 - dx * dx), 1e-6)
    ax, ay, az = s * (1.0 - dx * dx), -s * dx * dy, -s * dx * dz
    bx, by, bz = dy * az - dz * ay, dz * ax - dx * az, dx * ay - dy * ax
    nx, ny = low.shape
    weight_near = weight_far = sum_near = sum_far = square = wall = wall_path = 0.0
    for k in range(rays.response.shape[0]):
        u, v, length = rays.across_x[k], rays.across_y[k], rays.length[k]
        rx, ry, rz = dx + u * ax + v * bx, dy + u * ay + v * by, dz + u * az + v * bz
        stop = farthest / length
        t = 0.0
        if rz < -1e-6:
            stop = min(stop, oz / -rz)
            i = int((ox + rx * 0.5 * stop) / CELL)
            j = int((oy + ry * 0.5 * stop) / CELL)
            top = 0.0
            if i >= 0 and j >= 0 and i < nx and j < ny:
                top = footprint.nearby[i, j]
            t = max(0.0, (oz - top) / -rz - 1e-4)
        near = far = -1.0
        near_facing = far_facing = 1.0
        while t < stop:
            i, j = int((ox + rx * t) / CELL), int((oy + ry * t) / CELL)
            z = oz + rz * t
            if ox + rx * t >= 0 and oy + ry * t >= 0 and i < nx and j < ny:
                if near < 0 and z <= high[i, j]:
                    deep = high[i, j] - z
                    if deep > _WALL:
                        near, near_facing = t, _GRAZING
                    else:
                        near, near_facing = t + deep / rz, footprint.facing[i, j]
                if z <= low[i, j]:
                    deep = low[i, j] - z
                    if deep > _WALL:
                        far, far_facing = t, _GRAZING
                    else:
                        far, far_facing = t + deep / rz, footprint.facing[i, j]
                    break
            t += _PACE
        if far < 0:
            far = stop
        if near < 0:
            near, near_facing = far, far_facing
        path = max(near, 0.001) * length
        w = rays.response[k] * near_facing / (path * path)
        weight_near += w
        sum_near += w * path
        path = max(far, 0.001) * length
        w = rays.response[k] * far_facing / (path * path)
        weight_far += w
        sum_far += w * path
        square += w * path * path
        on_wall = rays.response[k] / (length * length * length)
        wall += on_wall
        wall_path += on_wall * length
    scale = wall / wall_path
    mean = sum_far / weight_far
    spread = np.sqrt(max(square / weight_far - mean * mean, 0.0))
    return sum_near / weight_near * scale, mean * scale, spread


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy", **NO_REFERENCES)
def cone_residual(
    end: Vector, direction: Vector, returned: bool, measured: float, target: Target, noise: Noise, rays: Rays
) -> tuple[float, float, float]:
    """Normalised residual of a wide beam that ends in `end`, or begins there if it met nothing, where the camera would
    have put it; the cap of the robust kernel; what it costs beyond."""
    x, y, z = end
    dx, dy, dz = direction
    origin = (x - measured * dx, y - measured * dy, z - measured * dz)
    range_max = target.optics.range_max
    near, far, spread = mean_range(origin, direction, 2.0 * range_max, rays, target)
    if not returned:
        return max(range_max - far, 0.0) / noise.table, CAP_FRONT, 0.0
    widen = CONE_SPREAD * spread
    variance = noise.surface * noise.surface + widen * widen
    beyond = 0.5 * np.log(variance / (noise.surface * noise.surface))
    std = np.sqrt(variance)
    residual = (measured - far) / std
    if near < far - 1e-4:
        s = 0.5 * residual * residual
        outside = (near - measured) / std
        if residual < 0 and robust_cost(s, CAP_FRONT) > CAP_BEHIND:
            return max(outside, 0.0), CAP_FRONT - CAP_BEHIND, beyond + CAP_BEHIND
    return residual, CAP_FRONT, beyond


@njit(cache=True, nogil=True, inline="always")
def moved_back(end: Vector, direction: Vector, r: Array, centroid: Array, k: int) -> tuple[Vector, Vector, float]:
    """A beam where the camera would have put it after a small step of component k of the correction; and that step.

    r (3, 3) is the correction's rotation, applied before the step.
    """
    q0, q1, q2 = end
    d0, d1, d2 = direction
    if k < 3:
        # back through the turn about base axis k: by -_TURN about R' e_k in the camera's placement
        a0, a1, a2 = r[k, 0], r[k, 1], r[k, 2]
        p0, p1, p2 = q0 - centroid[0], q1 - centroid[1], q2 - centroid[2]
        moved = (q0 - _TURN * (a1 * p2 - a2 * p1), q1 - _TURN * (a2 * p0 - a0 * p2), q2 - _TURN * (a0 * p1 - a1 * p0))
        turned = (d0 - _TURN * (a1 * d2 - a2 * d1), d1 - _TURN * (a2 * d0 - a0 * d2), d2 - _TURN * (a0 * d1 - a1 * d0))
        return moved, turned, _TURN
    moved = (q0 - _SHIFT * r[k - 3, 0], q1 - _SHIFT * r[k - 3, 1], q2 - _SHIFT * r[k - 3, 2])
    return moved, (d0, d1, d2), _SHIFT
