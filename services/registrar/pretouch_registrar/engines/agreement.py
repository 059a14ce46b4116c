"""How badly a set of beams disagrees with what the camera saw, for one pose correction: the cost of one sample.

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

from concurrent.futures import ThreadPoolExecutor

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
from pretouch_registrar.engines.problem import Problem

PRIOR_FLAT = 1.65
"""Standard deviations of the prior up to which a correction costs next to nothing: calibration errors are bounded
rather than normal, and a uniform error's bound is sqrt 3 of its standard deviations."""
PRIOR_WALL = 0.4
"""Standard deviations over which the prior falls off beyond."""
PRIOR_SAG = 0.1
"""Share of a normal prior's cost within."""
STEEP = 1.7
"""Most that a surface seen edge-on costs: a beam along a wall may end anywhere on it, so that its range says little."""
CONE_SPREAD = 0.25
"""Share of the spread of the paths in a cone that its mean may be wrong by."""
_CELLS_PER_M = 1.0 / CELL
_SHIFT, _TURN = 0.001, 0.012
"""m and rad: steps of the differences that stand for a wide beam's derivatives."""
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


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def rotation_of(w: Array) -> Array:
    """exp of a rotation vector (3,), by Rodrigues' formula."""
    angle = np.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    a, b = 1.0, 0.5
    if angle > 1e-8:
        a = np.sin(angle) / angle
        b = (1.0 - np.cos(angle)) / (angle * angle)
    x, y, z = w[0], w[1], w[2]
    r = np.empty((3, 3))
    r[0, 0] = 1 - b * (y * y + z * z)
    r[1, 1] = 1 - b * (x * x + z * z)
    r[2, 2] = 1 - b * (x * x + y * y)
    r[0, 1] = b * x * y - a * z
    r[1, 0] = b * x * y + a * z
    r[0, 2] = b * x * z + a * y
    r[2, 0] = b * x * z - a * y
    r[1, 2] = b * y * z - a * x
    r[2, 1] = b * y * z + a * x
    return r


@njit(cache=True, nogil=True)
def vector_of(r: Array) -> Array:
    """log of a rotation matrix (3, 3) by less than half a turn: its rotation vector (3,)."""
    v = 0.5 * np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    sine = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    if sine < 1e-9:
        return v
    return v * (np.arctan2(sine, 0.5 * (r[0, 0] + r[1, 1] + r[2, 2] - 1.0)) / sine)


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
def _miss_cost(
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


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy", inline="always")
def prior_cost(x: float, prior: float) -> tuple[float, float, float]:
    """Cost, slope and curvature of one component of a correction; `prior` is its inverse variance."""
    scale = np.sqrt(prior)
    z = x * scale
    beyond = abs(z) - PRIOR_FLAT
    cost, slope, bend = 0.5 * PRIOR_SAG * z * z, PRIOR_SAG * z, PRIOR_SAG
    if beyond > 0:
        cost += 0.5 * (beyond / PRIOR_WALL) ** 2
        slope += np.sign(z) * beyond / PRIOR_WALL**2
        bend += 1.0 / PRIOR_WALL**2
    return cost, slope * scale, bend * prior


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


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def total_cost(
    x: Array, factor: float, prior: Array, beams: Array, centroid: Array, optics: Array, table: Array, noise: Array,
    rays: Array, pixels: NDArray[np.float32], footprint: NDArray[np.float32], frame: Array,
) -> float:  # fmt: skip
    """Cost of the correction x (6,): weighted samples plus the prior; `factor` widens all noise (annealing)."""
    r = rotation_of(x[:3])
    wide = noise * factor
    out = np.zeros(12)
    cost = 0.0
    for k in range(6):
        cost += prior_cost(x[k], prior[k])[0]
    for n in range(beams.shape[0]):
        y0, y1, y2 = (
            beams[n, 0] - centroid[0] - x[3],
            beams[n, 1] - centroid[1] - x[4],
            beams[n, 2] - centroid[2] - x[5],
        )
        q0 = r[0, 0] * y0 + r[1, 0] * y1 + r[2, 0] * y2 + centroid[0]
        q1 = r[0, 1] * y0 + r[1, 1] * y1 + r[2, 1] * y2 + centroid[1]
        q2 = r[0, 2] * y0 + r[1, 2] * y1 + r[2, 2] * y2 + centroid[2]
        d0 = r[0, 0] * beams[n, 3] + r[1, 0] * beams[n, 4] + r[2, 0] * beams[n, 5]
        d1 = r[0, 1] * beams[n, 3] + r[1, 1] * beams[n, 4] + r[2, 1] * beams[n, 5]
        d2 = r[0, 2] * beams[n, 3] + r[1, 2] * beams[n, 4] + r[2, 2] * beams[n, 5]
        if rays.shape[0] > 0:
            e, cap, beyond = cone_residual(
                q0, q1, q2, d0, d1, d2, beams[n, 6], beams[n, 8], optics, table, wide, rays, footprint, frame
            )
            s = 0.5 * e * e
            cost += beams[n, 7] * (beyond + cap * s / (cap + s))
        elif beams[n, 6] > 0:
            cap, beyond = point_residual(q0, q1, q2, d0, d1, d2, optics, table, wide, pixels, footprint, frame, out)
            s = 0.5 * (out[0] * out[0] + out[4] * out[4] + out[8] * out[8])
            cost += beams[n, 7] * (beyond + cap * s / (cap + s))
        else:
            cost += beams[n, 7] * _miss_cost(q0, q1, q2, d0, d1, d2, optics, table, wide, footprint, frame)
    return cost


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def costs(
    xs: Array, factor: float, prior: Array, beams: Array, centroid: Array, optics: Array, table: Array, noise: Array,
    rays: Array, pixels: NDArray[np.float32], footprint: NDArray[np.float32], frame: Array,
) -> Array:  # fmt: skip
    """`total_cost` of each row of xs (m, 6)."""
    result = np.empty(xs.shape[0])
    for m in range(xs.shape[0]):
        result[m] = total_cost(
            xs[m], factor, prior, beams, centroid, optics, table, noise, rays, pixels, footprint, frame
        )
    return result


def spread_costs(xs: Array, factor: float, problem: Problem) -> Array:
    """Costs (m,) of corrections xs (m, 6) without the prior, on all threads: the kernels run without Python's lock."""
    arguments = (factor, np.zeros(6), *problem.arguments())
    if len(xs) * len(problem.beams) < _WORTH_A_THREAD:
        return np.asarray(costs(xs, *arguments), dtype=np.float64)
    parts = _pool.map(lambda part: costs(part, *arguments), np.array_split(np.ascontiguousarray(xs), _THREADS))
    return np.concatenate(list(parts))


_THREADS = 2
_pool = ThreadPoolExecutor(_THREADS, thread_name_prefix="agreement")
_WORTH_A_THREAD = 2000
"""Beams times corrections below which handing out the work takes longer than doing it."""


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def normal_equations(
    x: Array, factor: float, prior: Array, beams: Array, centroid: Array, optics: Array, table: Array, noise: Array,
    rays: Array, pixels: NDArray[np.float32], footprint: NDArray[np.float32], frame: Array,
) -> tuple[Array, Array, float]:  # fmt: skip
    """Information (6, 6), gradient (6,) and cost at x for a Gauss-Newton step, robust weights frozen (IRLS)."""
    r = rotation_of(x[:3])
    wide = noise * factor
    out, row = np.zeros(12), np.empty(6)
    information = np.zeros((6, 6))
    gradient = np.zeros(6)
    cost = 0.0
    for k in range(6):
        part, gradient[k], information[k, k] = prior_cost(x[k], prior[k])
        cost += part
    for n in range(beams.shape[0]):
        y0, y1, y2 = (
            beams[n, 0] - centroid[0] - x[3],
            beams[n, 1] - centroid[1] - x[4],
            beams[n, 2] - centroid[2] - x[5],
        )
        q0 = r[0, 0] * y0 + r[1, 0] * y1 + r[2, 0] * y2 + centroid[0]
        q1 = r[0, 1] * y0 + r[1, 1] * y1 + r[2, 1] * y2 + centroid[1]
        q2 = r[0, 2] * y0 + r[1, 2] * y1 + r[2, 2] * y2 + centroid[2]
        d0 = r[0, 0] * beams[n, 3] + r[1, 0] * beams[n, 4] + r[2, 0] * beams[n, 5]
        d1 = r[0, 1] * beams[n, 3] + r[1, 1] * beams[n, 4] + r[2, 1] * beams[n, 5]
        d2 = r[0, 2] * beams[n, 3] + r[1, 2] * beams[n, 4] + r[2, 2] * beams[n, 5]
        if rays.shape[0] > 0:
            e, cap, beyond = cone_residual(
                q0, q1, q2, d0, d1, d2, beams[n, 6], beams[n, 8], optics, table, wide, rays, footprint, frame
            )
            s = 0.5 * e * e
            cost += beams[n, 7] * (beyond + cap * s / (cap + s))
            if e == 0.0:
                continue
            weight = beams[n, 7] * (cap / (cap + s)) ** 2
            for k in range(6):
                t0, t1, t2, e0, e1, e2 = q0, q1, q2, d0, d1, d2
                if k < 3:
                    # back through the turn about base axis k: by -_TURN about R' e_k in the camera's placement
                    a0, a1, a2 = r[k, 0], r[k, 1], r[k, 2]
                    p0, p1, p2 = q0 - centroid[0], q1 - centroid[1], q2 - centroid[2]
                    t0 -= _TURN * (a1 * p2 - a2 * p1)
                    t1 -= _TURN * (a2 * p0 - a0 * p2)
                    t2 -= _TURN * (a0 * p1 - a1 * p0)
                    e0 -= _TURN * (a1 * d2 - a2 * d1)
                    e1 -= _TURN * (a2 * d0 - a0 * d2)
                    e2 -= _TURN * (a0 * d1 - a1 * d0)
                    pace = _TURN
                else:
                    t0, t1, t2 = t0 - _SHIFT * r[k - 3, 0], t1 - _SHIFT * r[k - 3, 1], t2 - _SHIFT * r[k - 3, 2]
                    pace = _SHIFT
                moved, _, _ = cone_residual(
                    t0, t1, t2, e0, e1, e2, beams[n, 6], beams[n, 8], optics, table, wide, rays, footprint, frame
                )
                row[k] = (moved - e) / pace
            for k in range(6):
                gradient[k] += weight * row[k] * e
                for m in range(6):
                    information[k, m] += weight * row[k] * row[m]
            continue
        if beams[n, 6] == 0:
            cost += beams[n, 7] * _miss_cost(q0, q1, q2, d0, d1, d2, optics, table, wide, footprint, frame)
            continue
        cap, beyond = point_residual(q0, q1, q2, d0, d1, d2, optics, table, wide, pixels, footprint, frame, out)
        s = 0.5 * (out[0] * out[0] + out[4] * out[4] + out[8] * out[8])
        cost += beams[n, 7] * (beyond + cap * s / (cap + s))
        weight = beams[n, 7] * (cap / (cap + s)) ** 2
        for part in range(0, 12, 4):
            if out[part] == 0.0:
                continue
            g0 = r[0, 0] * out[part + 1] + r[0, 1] * out[part + 2] + r[0, 2] * out[part + 3]
            g1 = r[1, 0] * out[part + 1] + r[1, 1] * out[part + 2] + r[1, 2] * out[part + 3]
            g2 = r[2, 0] * out[part + 1] + r[2, 1] * out[part + 2] + r[2, 2] * out[part + 3]
            row[0], row[1], row[2] = g1 * y2 - g2 * y1, g2 * y0 - g0 * y2, g0 * y1 - g1 * y0
            row[3], row[4], row[5] = -g0, -g1, -g2
            for k in range(6):
                gradient[k] += weight * row[k] * out[part]
                for m in range(6):
                    information[k, m] += weight * row[k] * row[m]
    return information, gradient, cost


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def sample_residuals(
    x: Array, beams: Array, centroid: Array, optics: Array, table: Array, noise: Array,
    rays: Array, pixels: NDArray[np.float32], footprint: NDArray[np.float32], frame: Array,
) -> tuple[Array, NDArray[np.bool_]]:  # fmt: skip
    """For each beam (n,): its residual along the surface's normal, m, and whether it agrees within 3 sigma.

    Misses do not agree with anything.
    """
    r = rotation_of(x[:3])
    out = np.zeros(12)
    residual = np.zeros(beams.shape[0])
    agrees = np.zeros(beams.shape[0], dtype=np.bool_)
    for n in range(beams.shape[0]):
        if beams[n, 6] == 0:
            continue
        y0, y1, y2 = (
            beams[n, 0] - centroid[0] - x[3],
            beams[n, 1] - centroid[1] - x[4],
            beams[n, 2] - centroid[2] - x[5],
        )
        q0 = r[0, 0] * y0 + r[1, 0] * y1 + r[2, 0] * y2 + centroid[0]
        q1 = r[0, 1] * y0 + r[1, 1] * y1 + r[2, 1] * y2 + centroid[1]
        q2 = r[0, 2] * y0 + r[1, 2] * y1 + r[2, 2] * y2 + centroid[2]
        d0 = r[0, 0] * beams[n, 3] + r[1, 0] * beams[n, 4] + r[2, 0] * beams[n, 5]
        d1 = r[0, 1] * beams[n, 3] + r[1, 1] * beams[n, 4] + r[2, 1] * beams[n, 5]
        d2 = r[0, 2] * beams[n, 3] + r[1, 2] * beams[n, 4] + r[2, 2] * beams[n, 5]
        point_residual(q0, q1, q2, d0, d1, d2, optics, table, noise, pixels, footprint, frame, out)
        residual[n] = out[0] / np.sqrt(out[1] * out[1] + out[2] * out[2] + out[3] * out[3])
        agrees[n] = out[0] * out[0] + out[4] * out[4] + out[8] * out[8] < 9.0
    return residual, agrees
