"""How one beam is explained by what the camera saw, under one pose correction, and what that costs.

A correction is x = (w, d): p -> exp(w) (p - c) + c + d, c the object's centroid, base axes. A returned beam's point is
carried back to where the camera would have put it and explained in the cheaper of two ways:

- by what the camera sees there: distance along that surface's normal; off the silhouette, of the nearest object
  pixel's surface, plus the distance to that pixel within the surface; where layers lie behind each other, as at a cup's
  rim, the front one beside it will do as well;
- by the table: its height above it.

A point whose beam came in through a seen part of the object has no business there: it also pays for how far inside the
object's footprint that was. Behind a seen surface, but not below it, may be a hidden side: that disagreement is capped
low. In front of it the camera would have seen it: capped high. A miss pays like a point below a seen part. A surface
seen edge-on by the beam explains little, since the beam could have ended anywhere along it, and costs `STEEP` at most.

A wide beam is compared by its range instead, with the mean range over its cone (`cone.mean_range`).

Costs saturate smoothly, cost = beyond + cap s / (cap + s) with s = half the squared normalised residual
(Geman-McClure).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch_registrar.engines.camera_model import (
    CELL,
    FRONT_PLANE,
    FRONT_POINT,
    INSIDE,
    KIND,
    NOWHERE,
    OBJECT,
    OTHER,
    OUTWARD,
    PLANE,
    POINT,
    TO_SURFACE,
    TOP,
    UNSEEN,
)  # fmt: skip
from pretouch_registrar.engines.cone import mean_range

STEEP = 1.7
"""Most that a surface seen edge-on costs: a beam along a wall may end anywhere on it, so that its range says little."""
CONE_SPREAD = 0.25
"""Share of the spread of the paths in a cone that its mean may be wrong by."""
_CELLS_PER_M = 1.0 / CELL
CAP_FRONT = 4.5
CAP_BEHIND = 1.8
EDGE_SLACK_PX = 0.7
"""A silhouette is known to about this many pixels: lateral distances below it cost nothing."""
FOOTPRINT_SLACK = 0.0015
"""m: likewise for the footprint's outline, half a cell."""
ON_SURFACE = 0.5
"""Squared normalised residual up to which a point is where something was seen, and cannot be below it."""
BELOW = 0.006
"""m: a point this far below a seen part of the object is below it, whatever the noise."""


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy", inline="always")
def project(x: float, y: float, z: float, o: Array) -> tuple[float, float, float]:
    """(u, v, depth) of a point in base; depth at most 1 mm where it is not in front of the camera."""
    x, y, z = x - o[9], y - o[10], z - o[11]
    depth = o[2] * x + o[5] * y + o[8] * z
    if depth < 1e-3:
        return 0.0, 0.0, 0.0
    u = o[12] * (o[0] * x + o[3] * y + o[6] * z) / depth + o[14]
    v = o[13] * (o[1] * x + o[4] * y + o[7] * z) / depth + o[15]
    return u, v, depth


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy", inline="always")
def cell_of(x: float, y: float, z: float, footprint: NDArray[np.float32], frame: Array) -> tuple[int, int]:
    """The footprint's cell that a point in base stands over; -1, -1 outside."""
    across = (frame[0] * x + frame[1] * y + frame[2] * z - frame[6]) * _CELLS_PER_M
    along = (frame[3] * x + frame[4] * y + frame[5] * z - frame[7]) * _CELLS_PER_M
    if across < 0 or along < 0 or across >= footprint.shape[1] or along >= footprint.shape[2]:
        return -1, -1
    return int(across), int(along)


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy", inline="always")
def _off_surface(
    x: float, y: float, z: float, pixels: NDArray[np.float32], i: int, j: int, plane: int
) -> float:  # fmt: skip
    """Signed distance of a point from a pixel's plane."""
    p = pixels
    return p[i, j, plane] * x + p[i, j, plane + 1] * y + p[i, j, plane + 2] * z - p[i, j, plane + 3]


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy", inline="always")
def _within_surface(
    x: float, y: float, z: float, distance: float, pixels: NDArray[np.float32], i: int, j: int, plane: int, point: int
) -> tuple[float, float, float, float]:  # fmt: skip
    """Distance within a pixel's plane from its point, and its direction; `distance` is that from the plane."""
    e0 = x - pixels[i, j, point] - distance * pixels[i, j, plane]
    e1 = y - pixels[i, j, point + 1] - distance * pixels[i, j, plane + 1]
    e2 = z - pixels[i, j, point + 2] - distance * pixels[i, j, plane + 2]
    length = np.sqrt(e0 * e0 + e1 * e1 + e2 * e2) + 1e-12
    return length, e0 / length, e1 / length, e2 / length


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy", inline="always")
def _inside(
    x: float, y: float, z: float, dx: float, dy: float, dz: float, above: float, table: Array, noise: Array,
    footprint: NDArray[np.float32], frame: Array, out: Array,
) -> float:  # fmt: skip
    """How far inside the footprint the beam that ends in (x, y, z) came in; with its gradient in `out` (12,)."""
    a, b = _pierced(x, y, z, dx, dy, dz, above, table, footprint, frame)
    if a < 0:
        return 0.0
    below = max(footprint[INSIDE, a, b] - FOOTPRINT_SLACK, 0.0) / noise[2]
    out[8] = below
    for k in range(3):
        out[9 + k] = -(footprint[OUTWARD, a, b] * frame[k] + footprint[OUTWARD + 1, a, b] * frame[3 + k]) / noise[2]
    return below


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy", inline="always")
def _pierced(
    x: float, y: float, z: float, dx: float, dy: float, dz: float, above: float, table: Array,
    footprint: NDArray[np.float32], frame: Array,
) -> tuple[int, int]:  # fmt: skip
    """The footprint's cell through which a beam that ends in (x, y, z), `above` the table, came in; -1, -1: none."""
    a, b = cell_of(x, y, z, footprint, frame)
    if a < 0 or footprint[TOP, a, b] <= above + BELOW:
        return -1, -1
    fall = -(table[0] * dx + table[1] * dy + table[2] * dz)
    if fall < 0.5:
        return -1, -1
    back = (footprint[TOP, a, b] - above) / fall
    a, b = cell_of(x - back * dx, y - back * dy, z - back * dz, footprint, frame)
    if a < 0 or footprint[TOP, a, b] <= above + BELOW:
        return -1, -1
    return a, b


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy", inline="always")
def _at_most(out: Array, limit: float) -> None:
    """Whoever lies on a surface that was seen is not below it: being below costs no more than lying off does."""
    if out[8] > limit:
        for k in range(3):
            out[9 + k] *= limit / out[8]
        out[8] = limit


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def point_residual(
    x: float, y: float, z: float, dx: float, dy: float, dz: float, optics: Array, table: Array, noise: Array,
    pixels: NDArray[np.float32], footprint: NDArray[np.float32], frame: Array, out: Array,
) -> tuple[float, float]:  # fmt: skip
    """The cheapest explanation of a returned point (x, y, z), where the camera would have put it.

    Fills `out` (12,): normalised residual and its gradient by the point, three times (surface or table; within the
    surface; inside the footprint). Returns the cap and what it costs beyond.
    """
    out[4] = 0.0
    out[8] = 0.0
    above = table[0] * x + table[1] * y + table[2] * z - table[3]
    height = above / noise[1]
    u, v, depth = project(x, y, z, optics)
    i, j = int(np.floor(v + 0.5)), int(np.floor(u + 0.5))
    if depth <= 0 or i < 0 or j < 0 or i >= pixels.shape[0] or j >= pixels.shape[1]:
        out[0] = height
        for k in range(3):
            out[1 + k] = table[k] / noise[1]
        return CAP_BEHIND, 0.0
    slack = EDGE_SLACK_PX * depth / optics[12]
    plane = PLANE
    distance = _off_surface(x, y, z, pixels, i, j, PLANE)
    surface = distance / noise[0]
    edge = e0 = e1 = e2 = 0.0
    if pixels[i, j, TO_SURFACE] > 0:
        length, e0, e1, e2 = _within_surface(x, y, z, distance, pixels, i, j, PLANE, POINT)
        edge = max(length - slack, 0.0) / noise[2]
    cost = surface * surface + edge * edge
    if cost > 4.0 and pixels[i, j, FRONT_PLANE + 3] < NOWHERE:
        before = _off_surface(x, y, z, pixels, i, j, FRONT_PLANE)
        length, f0, f1, f2 = _within_surface(x, y, z, before, pixels, i, j, FRONT_PLANE, FRONT_POINT)
        front, front_edge = before / noise[0], max(length - slack, 0.0) / noise[2]
        if front * front + front_edge * front_edge < cost:
            plane, surface, edge, e0, e1, e2 = FRONT_PLANE, front, front_edge, f0, f1, f2
            cost = surface * surface + edge * edge
    below = 0.0
    if min(cost, height * height) > ON_SURFACE:
        below = _inside(x, y, z, dx, dy, dz, above, table, noise, footprint, frame, out)
    kind = pixels[i, j, KIND]
    cap = CAP_FRONT
    if kind == OTHER or (below == 0 and (kind == UNSEEN or (kind == OBJECT and distance < 0))):
        cap = CAP_BEHIND
    if height * height < cost:
        out[0] = height
        for k in range(3):
            out[1 + k] = table[k] / noise[1]
        _at_most(out, abs(height))
        return cap, 0.0
    _at_most(out, np.sqrt(cost))
    out[0] = surface
    for k in range(3):
        out[1 + k] = pixels[i, j, plane + k] / noise[0]
    facing = abs(pixels[i, j, plane] * dx + pixels[i, j, plane + 1] * dy + pixels[i, j, plane + 2] * dz)
    steep = min(-np.log(max(facing, 0.02)), STEEP) / (noise[3] * noise[3])
    if edge > 0:
        out[4] = edge
        out[5], out[6], out[7] = e0 / noise[2], e1 / noise[2], e2 / noise[2]
    return cap - steep, steep


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def miss_cost(
    x: float, y: float, z: float, dx: float, dy: float, dz: float,
    optics: Array, table: Array, noise: Array, footprint: NDArray[np.float32], frame: Array,
) -> float:  # fmt: skip
    """What a beam without a return, given where the camera puts it, pays for piercing the seen object from above."""
    pace = 0.01
    for _ in range(int(optics[16] / pace + 0.5)):
        x, y, z = x + pace * dx, y + pace * dy, z + pace * dz
        a, b = cell_of(x, y, z, footprint, frame)
        if a >= 0 and footprint[TOP, a, b] > table[0] * x + table[1] * y + table[2] * z - table[3] + BELOW:
            below = max(footprint[INSIDE, a, b] - FOOTPRINT_SLACK, 0.0) / noise[2]
            s = 0.5 * below * below
            return CAP_FRONT * s / (CAP_FRONT + s)
    return 0.0


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def cone_residual(
    x: float, y: float, z: float, dx: float, dy: float, dz: float, hit: float, measured: float,
    optics: Array, table: Array, noise: Array, rays: Array, footprint: NDArray[np.float32], frame: Array,
) -> tuple[float, float, float]:  # fmt: skip
    """Normalised residual of a wide beam that ends in (x, y, z), or begins there if it met nothing; its cap; what it
    costs beyond: cost = beyond + cap s / (cap + s)."""
    x, y, z = x - measured * dx, y - measured * dy, z - measured * dz
    near, far, spread = mean_range(x, y, z, dx, dy, dz, 2.0 * optics[16], rays, table, footprint, frame)
    if hit == 0:
        return max(optics[16] - far, 0.0) / noise[1], CAP_FRONT, 0.0
    widen = CONE_SPREAD * spread
    variance = noise[0] * noise[0] + widen * widen
    beyond = 0.5 * np.log(variance / (noise[0] * noise[0]))
    std = np.sqrt(variance)
    residual = (measured - far) / std
    if near < far - 1e-4:
        s = 0.5 * residual * residual
        outside = (near - measured) / std
        if residual < 0 and CAP_FRONT * s / (CAP_FRONT + s) > CAP_BEHIND:
            return max(outside, 0.0), CAP_FRONT - CAP_BEHIND, beyond + CAP_BEHIND
    return residual, CAP_FRONT, beyond
