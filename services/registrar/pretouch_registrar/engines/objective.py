"""How badly beams disagree with what the camera saw, for one pose correction x = (w, d), see `correction`.

Each beam is carried back to where the camera would have put it and compared there by its kind of residual
(`residuals`); the robust kernel's costs, weighted, with the prior's, are the total cost and its normal equations.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pretouch.geometry import Array
from pretouch_registrar.engines import so3
from pretouch_registrar.engines.compiled import NO_REFERENCES
from pretouch_registrar.engines.correction import by_correction, carried_back, turned_back
from pretouch_registrar.engines.prior import prior_cost
from pretouch_registrar.engines.problem import Problem
from pretouch_registrar.engines.residuals.cone import cone_residual, moved_back
from pretouch_registrar.engines.residuals.miss import miss_cost
from pretouch_registrar.engines.residuals.point import PointResiduals, half_square, point_residual
from pretouch_registrar.engines.resources import Resources
from pretouch_registrar.engines.robust_kernel import robust_cost, robust_weight

_WORTH_A_THREAD = 2000
"""Beams times corrections below which handing out the work takes longer than doing it."""


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def total_cost(x: Array, problem: Problem) -> float:
    """Cost of the correction x (6,): weighted samples plus the prior."""
    return _summed(x, so3.exp(x[:3]), problem, PointResiduals(np.zeros(3), np.zeros((3, 3))))


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy", **NO_REFERENCES)
def _summed(x: Array, r: Array, problem: Problem, out: PointResiduals) -> float:
    """`total_cost` of x (6,), with r = exp(w) (3, 3), without allocation; `out` is room for a residual."""
    beams, target, noise, rays = problem.beams, problem.target, problem.noise, problem.rays
    centroid, weights = target.centroid, beams.weights
    cost = 0.0
    for k in range(6):
        cost += prior_cost(x[k], problem.prior[k])[0]
    for n in range(weights.shape[0]):
        point = carried_back(x, r, centroid, beams.points, n)
        direction = turned_back(r, beams.directions, n)
        if rays.response.shape[0] > 0:
            e, cap, beyond = cone_residual(point, direction, beams.returned[n], beams.ranges[n], target, noise, rays)
            cost += weights[n] * (beyond + robust_cost(0.5 * e * e, cap))
        elif beams.returned[n]:
            cap, beyond = point_residual(point, direction, target, noise, out)
            cost += weights[n] * (beyond + robust_cost(half_square(out), cap))
        else:
            cost += weights[n] * miss_cost(point, direction, target, noise)
    return cost


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def total_costs(xs: Array, problem: Problem) -> Array:
    """`total_cost` of each row of xs (m, 6)."""
    result = np.empty(xs.shape[0])
    for m in range(xs.shape[0]):
        result[m] = total_cost(xs[m], problem)
    return result


def spread_costs(xs: Array, problem: Problem, resources: Resources) -> Array:
    """`total_costs` (m,) of corrections xs (m, 6) without the prior, on all threads."""
    free = problem.free()
    if len(xs) * len(problem.beams.weights) < _WORTH_A_THREAD:
        return np.asarray(total_costs(xs, free), dtype=np.float64)
    parts = np.array_split(np.ascontiguousarray(xs), resources.threads)
    return np.concatenate(resources.map(lambda part: total_costs(part, free), parts))


@njit(cache=True, nogil=True, inline="always")
def _add(weight: float, row: Array, residual: float, information: Array, gradient: Array) -> None:
    """Adds one residual with derivatives `row` (6,) to the normal equations."""
    for k in range(6):
        gradient[k] += weight * row[k] * residual
        for m in range(6):
            information[k, m] += weight * row[k] * row[m]


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def normal_equations(x: Array, problem: Problem) -> tuple[Array, Array, float]:
    """Information (6, 6), gradient (6,) and cost at x for a Gauss-Newton step, robust weights frozen (IRLS)."""
    information, gradient = np.zeros((6, 6)), np.zeros(6)
    out = PointResiduals(np.zeros(3), np.zeros((3, 3)))
    cost = _fill(x, so3.exp(x[:3]), problem, out, np.empty(6), information, gradient)
    return information, gradient, cost


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy", **NO_REFERENCES)
def _fill(
    x: Array, r: Array, problem: Problem, out: PointResiduals, row: Array, information: Array, gradient: Array
) -> float:
    """Fills the `normal_equations`, with r = exp(w) (3, 3), without allocation; `out` and `row` (6,) are room."""
    beams, target, noise, rays = problem.beams, problem.target, problem.noise, problem.rays
    centroid, weights = target.centroid, beams.weights
    cost = 0.0
    for k in range(6):
        part, gradient[k], information[k, k] = prior_cost(x[k], problem.prior[k])
        cost += part
    for n in range(weights.shape[0]):
        point = carried_back(x, r, centroid, beams.points, n)
        direction = turned_back(r, beams.directions, n)
        if rays.response.shape[0] > 0:
            returned, measured = beams.returned[n], beams.ranges[n]
            e, cap, beyond = cone_residual(point, direction, returned, measured, target, noise, rays)
            s = 0.5 * e * e
            cost += weights[n] * (beyond + robust_cost(s, cap))
            if e == 0.0:
                continue
            for k in range(6):
                end, turned, pace = moved_back(point, direction, r, centroid, k)
                moved, _, _ = cone_residual(end, turned, returned, measured, target, noise, rays)
                row[k] = (moved - e) / pace
            _add(weights[n] * robust_weight(s, cap), row, e, information, gradient)
        elif beams.returned[n]:
            cap, beyond = point_residual(point, direction, target, noise, out)
            s = half_square(out)
            cost += weights[n] * (beyond + robust_cost(s, cap))
            weight = weights[n] * robust_weight(s, cap)
            for part in range(3):
                if out.values[part] != 0.0:
                    slope = (out.gradients[part, 0], out.gradients[part, 1], out.gradients[part, 2])
                    by_correction(x, r, centroid, beams.points, n, slope, row)
                    _add(weight, row, out.values[part], information, gradient)
        else:
            cost += weights[n] * miss_cost(point, direction, target, noise)
    return cost
