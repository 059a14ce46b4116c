"""How badly a set of beams disagrees with what the camera saw, for one pose correction x = (w, d).

p -> exp(w) (p - c) + c + d, c the object's centroid, base axes. Each beam is carried back to where the camera would
have put it and explained there (`explanation`); weighted sums, with the prior, are the cost and its normal equations.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch_registrar.engines.explanation import cone_residual, miss_cost, point_residual
from pretouch_registrar.engines.problem import Problem
from pretouch_registrar.engines.turns import rotation_of

PRIOR_FLAT = 1.65
"""Standard deviations of the prior up to which a correction costs next to nothing: calibration errors are bounded
rather than normal, and a uniform error's bound is sqrt 3 of its standard deviations."""
PRIOR_WALL = 0.4
"""Standard deviations over which the prior falls off beyond."""
PRIOR_SAG = 0.1
"""Share of a normal prior's cost within."""
_SHIFT, _TURN = 0.001, 0.012
"""m and rad: steps of the differences that stand for a wide beam's derivatives."""


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


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy", inline="always")
def carried(
    x: Array, r: Array, beams: Array, n: int, centroid: Array
) -> tuple[float, float, float, float, float, float]:
    """Beam n's point and direction where the camera would have put them."""
    y0 = beams[n, 0] - centroid[0] - x[3]
    y1 = beams[n, 1] - centroid[1] - x[4]
    y2 = beams[n, 2] - centroid[2] - x[5]
    q0 = r[0, 0] * y0 + r[1, 0] * y1 + r[2, 0] * y2 + centroid[0]
    q1 = r[0, 1] * y0 + r[1, 1] * y1 + r[2, 1] * y2 + centroid[1]
    q2 = r[0, 2] * y0 + r[1, 2] * y1 + r[2, 2] * y2 + centroid[2]
    d0 = r[0, 0] * beams[n, 3] + r[1, 0] * beams[n, 4] + r[2, 0] * beams[n, 5]
    d1 = r[0, 1] * beams[n, 3] + r[1, 1] * beams[n, 4] + r[2, 1] * beams[n, 5]
    d2 = r[0, 2] * beams[n, 3] + r[1, 2] * beams[n, 4] + r[2, 2] * beams[n, 5]
    return q0, q1, q2, d0, d1, d2


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
        q0, q1, q2, d0, d1, d2 = carried(x, r, beams, n, centroid)
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
            cost += beams[n, 7] * miss_cost(q0, q1, q2, d0, d1, d2, optics, table, wide, footprint, frame)
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
        q0, q1, q2, d0, d1, d2 = carried(x, r, beams, n, centroid)
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
            cost += beams[n, 7] * miss_cost(q0, q1, q2, d0, d1, d2, optics, table, wide, footprint, frame)
            continue
        cap, beyond = point_residual(q0, q1, q2, d0, d1, d2, optics, table, wide, pixels, footprint, frame, out)
        s = 0.5 * (out[0] * out[0] + out[4] * out[4] + out[8] * out[8])
        cost += beams[n, 7] * (beyond + cap * s / (cap + s))
        weight = beams[n, 7] * (cap / (cap + s)) ** 2
        y0 = beams[n, 0] - centroid[0] - x[3]
        y1 = beams[n, 1] - centroid[1] - x[4]
        y2 = beams[n, 2] - centroid[2] - x[5]
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
        q0, q1, q2, d0, d1, d2 = carried(x, r, beams, n, centroid)
        point_residual(q0, q1, q2, d0, d1, d2, optics, table, noise, pixels, footprint, frame, out)
        residual[n] = out[0] / np.sqrt(out[1] * out[1] + out[2] * out[2] + out[3] * out[3])
        agrees[n] = out[0] * out[0] + out[4] * out[4] + out[8] * out[8] < 9.0
    return residual, agrees
