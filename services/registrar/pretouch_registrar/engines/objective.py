"""The objective: the negative log posterior density of a pose correction x = (w, d), see `correction`.

Each beam is carried back to where the camera would have put it, and its residual there (`residuals`) gives a cost by
the robust kernel. The costs, weighted and divided by the problem's temperature, are the negative log likelihood; with
the prior's cost that is the energy. For a wide beam, each hypothesis about its response (`beam_response`) has a
likelihood for all samples together, and the likelihood is the mean of those.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pretouch.cancellation import check_cancelled
from pretouch.geometry import Array
from pretouch_registrar.engines import so3
from pretouch_registrar.engines.compiled import NO_REFERENCES
from pretouch_registrar.engines.correction import carry_back, fill_jacobian_row, turn_back
from pretouch_registrar.engines.prior import add_prior, compute_prior_cost
from pretouch_registrar.engines.registration_problem import RegistrationProblem
from pretouch_registrar.engines.residuals.cone import Spot, make_spot, spot_residual, step_beam, trace_spot
from pretouch_registrar.engines.residuals.miss import miss_cost
from pretouch_registrar.engines.residuals.point import PointResiduals, compute_half_square, point_residual
from pretouch_registrar.engines.resources import Resources
from pretouch_registrar.engines.robust_kernel import robust_cost, robust_weight

_MIN_PARALLEL_WORK = 2000
"""Beams times corrections below which one thread is quicker."""


@njit(cache=True, nogil=True, error_model="numpy")
def compute_energy(x: Array, problem: RegistrationProblem) -> float:
    """Negative log posterior density at the correction x (6,), up to a constant."""
    r = so3.exp(x[:3])
    energy = compute_prior_cost(x, problem.prior)
    if problem.cone.length.shape[0] == 0:
        return (
            energy + _sum_thin_costs(x, r, problem, PointResiduals(np.zeros(3), np.zeros((3, 3)))) / problem.temperature
        )
    costs = np.zeros(problem.cone.scales.shape[0])
    _add_cone_costs(x, r, problem, make_spot(problem.cone), costs)
    least = costs.min()
    likelihood = 0.0
    for h in range(costs.shape[0]):
        likelihood += np.exp((least - costs[h]) / problem.temperature)
    return energy + least / problem.temperature - np.log(likelihood / costs.shape[0])


@njit(cache=True, nogil=True, error_model="numpy", **NO_REFERENCES)
def _sum_thin_costs(x: Array, r: Array, problem: RegistrationProblem, out: PointResiduals) -> float:
    """Cost of thin beams at x (6,), with r = exp(w) (3, 3), without allocation; `out` is a buffer for a residual."""
    cost = 0.0
    for n in range(problem.beams.weights.shape[0]):
        cost += problem.beams.weights[n] * _compute_thin_cost(n, x, r, problem, out)
    return cost


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _compute_thin_cost(n: int, x: Array, r: Array, problem: RegistrationProblem, out: PointResiduals) -> float:
    """Cost of thin beam n, unweighted, as in `_sum_thin_costs`."""
    beams, target = problem.beams, problem.target
    point = carry_back(x, r, target.centroid, beams.points, n)
    direction = turn_back(r, beams.directions, n)
    if not beams.returned[n]:
        return miss_cost(point, direction, target, problem.noise)
    cap, beyond = point_residual(point, direction, target, problem.noise, out)
    return beyond + robust_cost(compute_half_square(out), cap)


@njit(cache=True, nogil=True, error_model="numpy", **NO_REFERENCES)
def _add_cone_costs(x: Array, r: Array, problem: RegistrationProblem, spot: Spot, costs: Array) -> None:
    """Adds the cost of wide beams at x (6,), with r = exp(w) (3, 3), under each hypothesis to `costs` (h,)."""
    beams, target, noise = problem.beams, problem.target, problem.noise
    range_max = target.optics.range_max
    for n in range(beams.weights.shape[0]):
        end = carry_back(x, r, target.centroid, beams.points, n)
        direction = turn_back(r, beams.directions, n)
        returned, measured = beams.returned[n], beams.ranges[n]
        interval = trace_spot(end, direction, returned, measured, target, problem.cone, spot)
        for h in range(costs.shape[0]):
            e, cap, beyond = spot_residual(h, returned, measured, interval, range_max, noise, spot)
            costs[h] += beams.weights[n] * (beyond + robust_cost(0.5 * e * e, cap))


@njit(cache=True, nogil=True, error_model="numpy", **NO_REFERENCES)
def _compute_wide_cost(n: int, x: Array, r: Array, problem: RegistrationProblem, spot: Spot) -> float:
    """Cost of wide beam n, unweighted, under a problem's only hypothesis."""
    beams, target = problem.beams, problem.target
    end = carry_back(x, r, target.centroid, beams.points, n)
    returned, measured = beams.returned[n], beams.ranges[n]
    interval = trace_spot(end, turn_back(r, beams.directions, n), returned, measured, target, problem.cone, spot)
    e, cap, beyond = spot_residual(0, returned, measured, interval, target.optics.range_max, problem.noise, spot)
    return beyond + robust_cost(0.5 * e * e, cap)


@njit(cache=True, nogil=True, error_model="numpy", **NO_REFERENCES)
def _fill_costs(
    x: Array, r: Array, problem: RegistrationProblem, out: PointResiduals, spot: Spot, costs: Array
) -> None:
    """Fills `costs` (n,) with that of each beam, unweighted, at x (6,), with r = exp(w) (3, 3)."""
    wide = problem.cone.length.shape[0] > 0
    for n in range(costs.shape[0]):
        if wide:
            costs[n] = _compute_wide_cost(n, x, r, problem, spot)
        else:
            costs[n] = _compute_thin_cost(n, x, r, problem, out)


@njit(cache=True, nogil=True, error_model="numpy")
def compute_costs(xs: Array, problem: RegistrationProblem) -> Array:
    """(m, n): the cost of each of n beams, unweighted and at temperature 1, at each of the corrections xs (m, 6).

    A problem of wide beams must have a single hypothesis.
    """
    result = np.empty((xs.shape[0], problem.beams.weights.shape[0]))
    spot, out = make_spot(problem.cone), PointResiduals(np.zeros(3), np.zeros((3, 3)))
    for m in range(xs.shape[0]):
        _fill_costs(xs[m], so3.exp(xs[m, :3]), problem, out, spot, result[m])
    return result


@njit(cache=True, nogil=True, error_model="numpy")
def find_likeliest_hypothesis(x: Array, problem: RegistrationProblem) -> int:
    """The hypothesis about the cone that explains all samples best under the correction x (6,)."""
    costs = np.zeros(problem.cone.scales.shape[0])
    _add_cone_costs(x, so3.exp(x[:3]), problem, make_spot(problem.cone), costs)
    return int(costs.argmin())


@njit(cache=True, nogil=True, error_model="numpy")
def compute_energies(xs: Array, problem: RegistrationProblem) -> Array:
    """`compute_energy` of each row of xs (m, 6)."""
    result = np.empty(xs.shape[0])
    for m in range(xs.shape[0]):
        result[m] = compute_energy(xs[m], problem)
    return result


def compute_energies_in_parallel(xs: Array, problem: RegistrationProblem, resources: Resources) -> Array:
    """`compute_energies` (m,) of corrections xs (m, 6), on all threads; engines that search end here if cancelled."""
    check_cancelled()
    if len(xs) * len(problem.beams.weights) < _MIN_PARALLEL_WORK:
        return np.asarray(compute_energies(xs, problem), dtype=np.float64)
    parts = np.array_split(np.ascontiguousarray(xs), resources.threads)
    return np.concatenate(resources.map(lambda part: compute_energies(part, problem), parts))


def assume_likeliest_hypothesis(x: Array, problem: RegistrationProblem) -> RegistrationProblem:
    """The problem with only its likeliest hypothesis at x (6,); that of a thin beam is returned unchanged."""
    return problem.assume_hypothesis(find_likeliest_hypothesis(x, problem)) if problem.wide else problem


@njit(cache=True, nogil=True, inline="always")
def _accumulate(weight: float, row: Array, residual: float, information: Array, gradient: Array) -> None:
    """Adds one residual with derivatives `row` (6,) to the normal equations."""
    for k in range(6):
        gradient[k] += weight * row[k] * residual
        for m in range(6):
            information[k, m] += weight * row[k] * row[m]


@njit(cache=True, nogil=True, error_model="numpy")
def linearize(x: Array, problem: RegistrationProblem) -> tuple[Array, Array, float]:
    """Information (6, 6), gradient (6,) and energy at x for a Gauss-Newton step, with fixed robust weights (IRLS).

    A problem of wide beams must have a single hypothesis.
    """
    information, gradient, row = np.zeros((6, 6)), np.zeros(6), np.empty(6)
    r = so3.exp(x[:3])
    if problem.cone.length.shape[0] == 0:
        cost = _linearize_thin(x, r, problem, PointResiduals(np.zeros(3), np.zeros((3, 3))), row, information, gradient)
    else:
        cost = _linearize_wide(x, r, problem, make_spot(problem.cone), row, information, gradient)
    gradient /= problem.temperature
    information /= problem.temperature
    energy = cost / problem.temperature + add_prior(x, problem.prior, information, gradient)
    return information, gradient, energy


@njit(cache=True, nogil=True, error_model="numpy", **NO_REFERENCES)
def _linearize_thin(
    x: Array,
    r: Array,
    problem: RegistrationProblem,
    out: PointResiduals,
    row: Array,
    information: Array,
    gradient: Array,
) -> float:
    """Adds thin beams to the normal equations at x (6,), with r = exp(w) (3, 3); returns their cost."""
    beams, target, noise = problem.beams, problem.target, problem.noise
    centroid, weights = target.centroid, beams.weights
    cost = 0.0
    for n in range(weights.shape[0]):
        point = carry_back(x, r, centroid, beams.points, n)
        direction = turn_back(r, beams.directions, n)
        if not beams.returned[n]:
            cost += weights[n] * miss_cost(point, direction, target, noise)
            continue
        cap, beyond = point_residual(point, direction, target, noise, out)
        s = compute_half_square(out)
        cost += weights[n] * (beyond + robust_cost(s, cap))
        weight = weights[n] * robust_weight(s, cap)
        for part in range(3):
            if out.values[part] != 0.0:
                slope = (out.gradients[part, 0], out.gradients[part, 1], out.gradients[part, 2])
                fill_jacobian_row(x, r, centroid, beams.points, n, slope, row)
                _accumulate(weight, row, out.values[part], information, gradient)
    return cost


@njit(cache=True, nogil=True, error_model="numpy", **NO_REFERENCES)
def _linearize_wide(
    x: Array, r: Array, problem: RegistrationProblem, spot: Spot, row: Array, information: Array, gradient: Array
) -> float:
    """As `_linearize_thin` for wide beams and one hypothesis."""
    beams, target, noise, cone = problem.beams, problem.target, problem.noise, problem.cone
    centroid, weights, range_max = target.centroid, beams.weights, target.optics.range_max
    cost = 0.0
    for n in range(weights.shape[0]):
        end = carry_back(x, r, centroid, beams.points, n)
        direction = turn_back(r, beams.directions, n)
        returned, measured = beams.returned[n], beams.ranges[n]
        interval = trace_spot(end, direction, returned, measured, target, cone, spot)
        e, cap, beyond = spot_residual(0, returned, measured, interval, range_max, noise, spot)
        s = 0.5 * e * e
        cost += weights[n] * (beyond + robust_cost(s, cap))
        if e == 0.0:
            continue
        for k in range(6):
            moved_end, turned, pace = step_beam(end, direction, r, centroid, k)
            interval = trace_spot(moved_end, turned, returned, measured, target, cone, spot)
            moved, _, _ = spot_residual(0, returned, measured, interval, range_max, noise, spot)
            row[k] = (moved - e) / pace
        _accumulate(weights[n] * robust_weight(s, cap), row, e, information, gradient)
    return cost
