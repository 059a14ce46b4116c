"""The residual of a wide beam: its range, or its miss, and the range predicted under each hypothesis about its cone.

The surface is that of the footprint, seen from above, other objects included. Where the camera saw nothing, it lies
between the table and the line of sight above it, and the prediction is an interval.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch_registrar.engines.beam_response import Cone
from pretouch_registrar.engines.camera_model import CELL, Footprint
from pretouch_registrar.engines.compiled import NO_REFERENCES
from pretouch_registrar.engines.correction import Vector
from pretouch_registrar.engines.registration_problem import Noise, Target
from pretouch_registrar.engines.robust_kernel import CAP_BEHIND, CAP_FRONT, robust_cost

CONE_SPREAD = 0.25
"""Error of the predicted range, as a share of the standard deviation of the paths in the cone."""
_WALL = 0.007
"""m: a ray that is this far below the surface has hit a wall, not a slope."""
_GRAZING = 0.25
"""Cosine of the incidence on a wall."""
_LEVEL = 0.5
"""Downward component of a ray below which it is followed step by step: it may meet a wall from the side."""
_LEVEL_STEP = 0.002
_LEVEL_PART = 0.06
"""m: parts of such a ray in whose middles `Footprint.nearby` is looked up: if it passes above, it meets nothing."""
_WALL_FACING = 0.7
"""Mean cosine of the incidence of a level ray on a wall of unknown direction."""
_FLAT = 0.001
"""m: where nothing within the cone's reach is higher than this, the surface is the table."""
_BISECTIONS = 3
_MAX_LOOKUPS = 4
_LEAST_PATH = 0.001
_SHIFT, _TURN = 0.001, 0.012
"""m and rad: steps of the finite differences for a wide beam's derivatives."""


class Spot(NamedTuple):
    """Buffers for the paths of one beam and its predicted range.

    Attributes:
        near, far: (k,), m: each ray's path to the nearest and to the farthest surface that is possible.
        near_facing, far_facing: (k,), cosine of incidence there.
        weights: (l, k), a buffer.
        nearest, means: (h,), m: the predicted range from `near` and from `far`.
        spreads: (h,), m^2: weighted variance of the paths `far`.
    """

    near: Array
    far: Array
    near_facing: Array
    far_facing: Array
    weights: Array
    nearest: Array
    means: Array
    spreads: Array


@njit(cache=True, nogil=True)
def make_spot(cone: Cone) -> Spot:
    """Buffers for the beams of a cone."""
    k, h = cone.length.shape[0], cone.scales.shape[0]
    weights = np.empty((cone.decays.shape[0], k))
    return Spot(np.empty(k), np.empty(k), np.empty(k), np.empty(k), weights, np.empty(h), np.empty(h), np.empty(h))


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _look_up_surface(
    x: float, y: float, heights: NDArray[np.float32], facing: NDArray[np.float32]
) -> tuple[float, float]:
    """The surface's height, m, and the cosine of its slope at a place of the footprint; the table's beyond it."""
    if x >= 0 and y >= 0:
        i, j = int(x / CELL), int(y / CELL)
        if i < heights.shape[0] and j < heights.shape[1]:
            return heights[i, j], facing[i, j]
    return 0.0, 1.0


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _look_up_nearby(x: float, y: float, footprint: Footprint) -> tuple[float, bool]:
    """`Footprint.nearby`, m, and `Footprint.hidden` at a place of the footprint."""
    if x >= 0 and y >= 0:
        i, j = int(x / CELL), int(y / CELL)
        if i < footprint.nearby.shape[0] and j < footprint.nearby.shape[1]:
            return footprint.nearby[i, j], footprint.hidden[i, j]
    return 0.0, False


@njit(cache=True, nogil=True, error_model="numpy", **NO_REFERENCES)
def _intersect_surface(
    origin: Vector, ray: Vector, start: float, stop: float, heights: NDArray[np.float32], facing: NDArray[np.float32]
) -> tuple[float, float]:
    """Where a falling ray hits the surface, from `start` to `stop` in units of its direction; and the cosine there.

    The ray is repeatedly advanced to the height of the surface below it, which is quick as surfaces are mostly flat.
    """
    above = at = start
    slope = 1.0
    for look in range(_MAX_LOOKUPS):
        height, slope = _look_up_surface(origin[0] + ray[0] * at, origin[1] + ray[1] * at, heights, facing)
        level = (origin[2] - height) / -ray[2]
        if level <= at + 0.0005:
            if look == 0 or level > at - _WALL:
                return max(level, start), slope
            below = at
            for _ in range(_BISECTIONS):
                at = 0.5 * (above + below)
                height, _ = _look_up_surface(origin[0] + ray[0] * at, origin[1] + ray[1] * at, heights, facing)
                if (origin[2] - height) / -ray[2] <= at:
                    below = at
                else:
                    above = at
            return below, _GRAZING
        above = at
        at = min(level, stop)
    return at, slope


@njit(cache=True, nogil=True, error_model="numpy", **NO_REFERENCES)
def _follow_level_ray(
    origin: Vector, ray: Vector, stop: float, heights: NDArray[np.float32], facing: NDArray[np.float32]
) -> float:
    """Where a ray that hardly falls, or rises, first is below the surface, in units of its direction; else `stop`."""
    at = _LEVEL_STEP
    while at < stop:
        height, _ = _look_up_surface(origin[0] + ray[0] * at, origin[1] + ray[1] * at, heights, facing)
        if origin[2] + ray[2] * at <= height:
            return at
        at += _LEVEL_STEP
    return stop


@njit(cache=True, nogil=True, error_model="numpy", **NO_REFERENCES)
def _trace_level_ray(k: int, origin: Vector, ray: Vector, length: float, target: Target, spot: Spot) -> bool:
    """Fills path k of the spot with that of a ray that hardly falls; returns whether `near` and `far` differ."""
    footprint, reach = target.footprint, target.optics.range_max / length
    table = origin[2] / -ray[2] if ray[2] < 0.0 else 2.0 * reach
    stop = min(reach, table)
    open_path, open_facing = 2.0 * target.optics.range_max, 0.05
    if table <= reach:
        open_path, open_facing = max(table, _LEAST_PATH) * length, max(-ray[2] / length, 0.05)
    far = near = stop
    top, hidden = 0.0, False
    parts = int(stop * length / _LEVEL_PART) + 1
    for part in range(parts):
        at = (part + 0.5) / parts * stop
        nearby, unseen = _look_up_nearby(origin[0] + ray[0] * at, origin[1] + ray[1] * at, footprint)
        top, hidden = max(top, nearby), hidden or unseen
    if min(origin[2], origin[2] + ray[2] * stop) <= top:
        far = _follow_level_ray(origin, ray, stop, footprint.low, footprint.facing)
        near = far
        if hidden:
            near = _follow_level_ray(origin, ray, far, footprint.high, footprint.facing)
    spot.far[k], spot.far_facing[k] = (far * length, _WALL_FACING) if far < stop else (open_path, open_facing)
    spot.near[k], spot.near_facing[k] = (near * length, _WALL_FACING) if near < stop else (open_path, open_facing)
    return spot.far[k] - spot.near[k] > 1e-3


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _find_axis_across(direction: Vector) -> Vector:
    """A unit vector perpendicular to a direction."""
    x, y, z = direction
    if abs(x) > 0.9:
        s = 1.0 / np.sqrt(1.0 - y * y)
        return -s * x * y, s * (1.0 - y * y), -s * y * z
    s = 1.0 / np.sqrt(1.0 - x * x)
    return s * (1.0 - x * x), -s * x * y, -s * x * z


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _rotate_to_table(vector: Vector, footprint: Footprint, normal: Array) -> Vector:
    """A vector in base, in the table's axes."""
    a, b = footprint.x_axis, footprint.y_axis
    return (
        a[0] * vector[0] + a[1] * vector[1] + a[2] * vector[2],
        b[0] * vector[0] + b[1] * vector[1] + b[2] * vector[2],
        normal[0] * vector[0] + normal[1] * vector[1] + normal[2] * vector[2],
    )


@njit(cache=True, nogil=True, error_model="numpy", **NO_REFERENCES)
def _trace_rays(origin: Vector, direction: Vector, target: Target, cone: Cone, spot: Spot) -> bool:
    """Fills the spot's paths for a module at `origin`; returns whether `near` and `far` differ."""
    footprint = target.footprint
    farthest = 2.0 * target.optics.range_max
    px, py, pz = _rotate_to_table(origin, footprint, target.table.normal)
    o = (px - footprint.corner[0], py - footprint.corner[1], pz - target.table.offset)
    dx, dy, dz = _rotate_to_table(direction, footprint, target.table.normal)
    ax, ay, az = _find_axis_across((dx, dy, dz))
    bx, by, bz = dy * az - dz * ay, dz * ax - dx * az, dx * ay - dy * ax
    several = False
    for k in range(cone.length.shape[0]):
        u, v, length = cone.across_x[k], cone.across_y[k], cone.length[k]
        ray = (dx + u * ax + v * bx, dy + u * ay + v * by, dz + u * az + v * bz)
        if ray[2] > -_LEVEL * length:
            several = _trace_level_ray(k, o, ray, length, target, spot) or several
            continue
        stop = min(farthest / length, o[2] / -ray[2])
        top, hidden = _look_up_nearby(o[0] + 0.5 * ray[0] * stop, o[1] + 0.5 * ray[1] * stop, footprint)
        if top <= _FLAT:
            spot.near[k] = spot.far[k] = max(stop, _LEAST_PATH) * length
            spot.near_facing[k] = spot.far_facing[k] = -ray[2] / length
            continue
        start = min(max(_LEAST_PATH, (o[2] - top) / -ray[2]), stop)
        far, facing = _intersect_surface(o, ray, start, stop, footprint.low, footprint.facing)
        spot.far[k], spot.far_facing[k] = max(far, _LEAST_PATH) * length, facing
        near = far
        if hidden:
            near, facing = _intersect_surface(o, ray, start, stop, footprint.high, footprint.facing)
        spot.near[k], spot.near_facing[k] = max(near, _LEAST_PATH) * length, facing
        several = several or far - near > 1e-3
    return several


@njit(cache=True, nogil=True, error_model="numpy", **NO_REFERENCES)
def _average_paths(paths: Array, facing: Array, cone: Cone, spot: Spot, means: Array) -> None:
    """Fills `means` (h,) and the spot's `spreads`: predicted range and variance of paths (k,) under each hypothesis."""
    count, lengths = paths.shape[0], cone.decays.shape[0]
    first = paths[0]
    for k in range(1, count):
        first = min(first, paths[k])
    for k in range(count):
        base, beyond = facing[k] / (paths[k] * paths[k]), paths[k] - first
        fade = 1.0
        for b in range(lengths):
            if b > 0 and cone.decays[b] == 2.0 * cone.decays[b - 1]:
                fade = fade * fade
            elif beyond * cone.decays[b] > 0.0:
                fade = np.exp(-beyond * cone.decays[b])
            spot.weights[b, k] = base * fade
    for w in range(cone.profiles.shape[0]):
        for b in range(lengths):
            total = mean = square = 0.0
            for k in range(count):
                weight = cone.profiles[w, k] * spot.weights[b, k]
                total += weight
                weight *= paths[k]
                mean += weight
                square += weight * paths[k]
            mean /= total
            h = w * lengths + b
            means[h] = mean * cone.scales[h]
            spot.spreads[h] = max(square / total - mean * mean, 0.0)


@njit(cache=True, nogil=True, error_model="numpy", **NO_REFERENCES)
def trace_spot(
    end: Vector, direction: Vector, returned: bool, measured: float, target: Target, cone: Cone, spot: Spot
) -> bool:
    """Fills the spot for a beam that ends at `end`, or begins there without a return, as carried back.

    Returns whether the prediction is an interval, from `nearest` to `means`.
    """
    x, y, z = end
    dx, dy, dz = direction
    origin = (x - measured * dx, y - measured * dy, z - measured * dz)
    several = _trace_rays(origin, direction, target, cone, spot)
    if several and returned:
        _average_paths(spot.near, spot.near_facing, cone, spot, spot.nearest)
    _average_paths(spot.far, spot.far_facing, cone, spot, spot.means)
    return several and returned


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def spot_residual(
    h: int, returned: bool, measured: float, interval: bool, range_max: float, noise: Noise, spot: Spot
) -> tuple[float, float, float]:
    """Under hypothesis h: the normalised residual, the cap of the robust kernel, and the additional cost."""
    variance = noise.surface * noise.surface + CONE_SPREAD * CONE_SPREAD * spot.spreads[h]
    std = np.sqrt(variance)
    if not returned:
        return max(range_max - spot.means[h], 0.0) / std, CAP_FRONT, 0.0
    beyond = 0.5 * np.log(variance / (noise.surface * noise.surface))
    residual = (measured - spot.means[h]) / std
    if interval and robust_cost(0.5 * residual * residual, CAP_FRONT) > CAP_BEHIND:
        # a farther hidden surface may also lower the mean, where the nearest part has most weight
        low, high = min(spot.nearest[h], spot.means[h]), max(spot.nearest[h], spot.means[h])
        outside = max(low - measured, measured - high, 0.0) / std
        if outside < abs(residual):
            return outside, CAP_FRONT - CAP_BEHIND, beyond + CAP_BEHIND
    return residual, CAP_FRONT, beyond


@njit(cache=True, nogil=True, inline="always")
def step_beam(end: Vector, direction: Vector, r: Array, centroid: Array, k: int) -> tuple[Vector, Vector, float]:
    """A carried back beam after a small step of component k of the correction; and that step.

    r (3, 3) is the correction's rotation before the step.
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
