"""How badly beams disagree with what the camera saw, for one pose correction x = (w, d), see `correction`.

Each beam is carried back to where the camera would have put it and compared there by its kind of residual
(`residuals`). The robust kernel's costs, weighted and divided by the problem's temperature, are the negative log
likelihood; with the prior's cost that is the energy, the negative logarithm of the posterior's density. Of a wide beam
each hypothesis about the cone (`cone`) has a likelihood of its own for all samples together, and their mean counts.
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
from pretouch_registrar.engines.residuals.cone import Spot, measure, moved_back, spot_of, spot_residual
from pretouch_registrar.engines.residuals.miss import miss_cost
from pretouch_registrar.engines.residuals.point import PointResiduals, half_square, point_residual
from pretouch_registrar.engines.resources import Resources
from pretouch_registrar.engines.robust_kernel import robust_cost, robust_weight

_WORTH_A_THREAD = 2000
"""Beams times corrections below which handing out the work takes longer than doing it."""


@njit(cache=True, nogil=True, error_model="numpy")
def energy_of(x: Array, problem: Problem) -> float:
    """Negative logarithm of the posterior's density at the correction x (6,), but for a constant."""
    r = so3.exp(x[:3])
    energy = 0.0
    for k in range(6):
        energy += prior_cost(x[k], problem.prior[k])[0]
    if problem.cone.length.shape[0] == 0:
        return energy + _thin_cost(x, r, problem, PointResiduals(np.zeros(3), np.zeros((3, 3)))) / problem.temperature
    costs = np.zeros(problem.cone.scales.shape[0])
    _add_cone_costs(x, r, problem, spot_of(problem.cone), costs)
    least = costs.min()
    likelihood = 0.0
    for h in range(costs.shape[0]):
        likelihood += np.exp((least - costs[h]) / problem.temperature)
    return energy + least / problem.temperature - np.log(likelihood / costs.shape[0])


@njit(cache=True, nogil=True, error_model="numpy", **NO_REFERENCES)
def _thin_cost(x: Array, r: Array, problem: Problem, out: PointResiduals) -> float:
    """Cost of thin beams at x (6,), with r = exp(w) (3, 3), without allocation; `out` is room for a residual."""
    beams, target, noise = problem.beams, problem.target, problem.noise
    centroid, weights = target.centroid, beams.weights
    cost = 0.0
    for n in range(weights.shape[0]):
        point = carried_back(x, r, centroid, beams.points, n)
        direction = turned_back(r, beams.directions, n)
        if beams.returned[n]:
            cap, beyond = point_residual(point, direction, target, noise, out)
            cost += weights[n] * (beyond + robust_cost(half_square(out), cap))
        else:
            cost += weights[n] * miss_cost(point, direction, target, noise)
    return cost


@njit(cache=True, nogil=True, error_model="numpy", **NO_REFERENCES)
def _add_cone_costs(x: Array, r: Array, problem: Problem, spot: Spot, costs: Array) -> None:
    """Adds the cost of wide beams at x (6,), with r = exp(w) (3, 3), to `costs` (h,), that of each hypothesis."""
    beams, target, noise = problem.beams, problem.target, problem.noise
    range_max = target.optics.range_max
    for n in range(beams.weights.shape[0]):
        end = carried_back(x, r, target.centroid, beams.points, n)
        direction = turned_back(r, beams.directions, n)
        returned, measured = beams.returned[n], beams.ranges[n]
        interval = measure(end, direction, returned, measured, target, problem.cone, spot)
        for h in range(costs.shape[0]):
            e, cap, beyond = spot_residual(h, returned, measured, interval, range_max, noise, spot)
            costs[h] += beams.weights[n] * (beyond + robust_cost(0.5 * e * e, cap))


@njit(cache=True, nogil=True, error_model="numpy")
def likeliest_hypothesis(x: Array, problem: Problem) -> int:
    """The hypothesis about the cone that explains all samples best under the correction x (6,)."""
    costs = np.zeros(problem.cone.scales.shape[0])
    _add_cone_costs(x, so3.exp(x[:3]), problem, spot_of(problem.cone), costs)
    return int(costs.argmin())


@njit(cache=True, nogil=True, error_model="numpy")
def energies(xs: Array, problem: Problem) -> Array:
    """`energy_of` each row of xs (m, 6)."""
    result = np.empty(xs.shape[0])
    for m in range(xs.shape[0]):
        result[m] = energy_of(xs[m], problem)
    return result


def spread_energies(xs: Array, problem: Problem, resources: Resources) -> Array:
    """`energies` (m,) of corrections xs (m, 6), on all threads."""
    if len(xs) * len(problem.beams.weights) < _WORTH_A_THREAD:
        return np.asarray(energies(xs, problem), dtype=np.float64)
    parts = np.array_split(np.ascontiguousarray(xs), resources.threads)
    return np.concatenate(resources.map(lambda part: energies(part, problem), parts))


def supposing_likeliest(x: Array, problem: Problem) -> Problem:
    """The problem with its likeliest hypothesis at x (6,) alone; a thin beam's as it is."""
    return problem.supposing(likeliest_hypothesis(x, problem)) if problem.wide else problem


@njit(cache=True, nogil=True, inline="always")
def _add(weight: float, row: Array, residual: float, information: Array, gradient: Array) -> None:
    """Adds one residual with derivatives `row` (6,) to the normal equations."""
    for k in range(6):
        gradient[k] += weight * row[k] * residual
        for m in range(6):
            information[k, m] += weight * row[k] * row[m]


@njit(cache=True, nogil=True, error_model="numpy")
def normal_equations(x: Array, problem: Problem) -> tuple[Array, Array, float]:
    """Information (6, 6), gradient (6,) and energy at x for a Gauss-Newton step, robust weights frozen (IRLS).

    A problem of wide beams must suppose one hypothesis.
    """
    information, gradient, row = np.zeros((6, 6)), np.zeros(6), np.empty(6)
    r = so3.exp(x[:3])
    if problem.cone.length.shape[0] == 0:
        cost = _fill_thin(x, r, problem, PointResiduals(np.zeros(3), np.zeros((3, 3))), row, information, gradient)
    else:
        cost = _fill_wide(x, r, problem, spot_of(problem.cone), row, information, gradient)
    energy = cost / problem.temperature
    for k in range(6):
        gradient[k] /= problem.temperature
        for m in range(6):
            information[k, m] /= problem.temperature
        part, slope, bend = prior_cost(x[k], problem.prior[k])
        energy += part
        gradient[k] += slope
        information[k, k] += bend
    return information, gradient, energy


@njit(cache=True, nogil=True, error_model="numpy", **NO_REFERENCES)
def _fill_thin(
    x: Array, r: Array, problem: Problem, out: PointResiduals, row: Array, information: Array, gradient: Array
) -> float:
    """Adds thin beams to the normal equations at x (6,), with r = exp(w) (3, 3); returns their cost."""
    beams, target, noise = problem.beams, problem.target, problem.noise
    centroid, weights = target.centroid, beams.weights
    cost = 0.0
    for n in range(weights.shape[0]):
        point = carried_back(x, r, centroid, beams.points, n)
        direction = turned_back(r, beams.directions, n)
        if not beams.returned[n]:
            cost += weights[n] * miss_cost(point, direction, target, noise)
            continue
        cap, beyond = point_residual(point, direction, target, noise, out)
        s = half_square(out)
        cost += weights[n] * (beyond + robust_cost(s, cap))
        weight = weights[n] * robust_weight(s, cap)
        for part in range(3):
            if out.values[part] != 0.0:
                slope = (out.gradients[part, 0], out.gradients[part, 1], out.gradients[part, 2])
                by_correction(x, r, centroid, beams.points, n, slope, row)
                _add(weight, row, out.values[part], information, gradient)
    return cost


@njit(cache=True, nogil=True, error_model="numpy", **NO_REFERENCES)
def _fill_wide(
    x: Array, r: Array, problem: Problem, spot: Spot, row: Array, information: Array, gradient: Array
) -> float:
    """As `_fill_thin` for wide beams and one hypothesis."""
    beams, target, noise, cone = problem.beams, problem.target, problem.noise, problem.cone
    centroid, weights, range_max = target.centroid, beams.weights, target.optics.range_max
    cost = 0.0
    for n in range(weights.shape[0]):
        end = carried_back(x, r, centroid, beams.points, n)
        direction = turned_back(r, beams.directions, n)
        returned, measured = beams.returned[n], beams.ranges[n]
        interval = measure(end, direction, returned, measured, target, cone, spot)
        e, cap, beyond = spot_residual(0, returned, measured, interval, range_max, noise, spot)
        s = 0.5 * e * e
        cost += weights[n] * (beyond + robust_cost(s, cap))
        if e == 0.0:
            continue
        for k in range(6):
            moved_end, turned, pace = moved_back(end, direction, r, centroid, k)
            interval = measure(moved_end, turned, returned, measured, target, cone, spot)
            moved, _, _ = spot_residual(0, returned, measured, interval, range_max, noise, spot)
            row[k] = (moved - e) / pace
        _add(weights[n] * robust_weight(s, cap), row, e, information, gradient)
    return cost
