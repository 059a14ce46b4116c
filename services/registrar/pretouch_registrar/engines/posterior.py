"""Engine `posterior`: hits and misses against everything the camera saw, searched over the whole prior.

The correction that agrees best with all samples and the prior (maximum a posteriori): a population of corrections drawn
from the prior follows the cost while the noise narrows, its best members are refined by Levenberg-Marquardt, and the
cheapest one wins. Its covariance is the inverse of the cost's curvature over a neighbourhood as wide as the covariance
itself, so that edges, caps and misses count, which derivatives at a point would not see.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch_registrar.engines.agreement import Problem, costs, normal_equations, rotation_of, vector_of
from pretouch_registrar.engines.solution import Solution

_DRAWS = 600
_POPULATION = 200
_ANNEALING = ((4.0, 1), (2.8, 1), (2.0, 1), (1.4, 2), (1.0, 2))
"""Noise factor and Metropolis steps at it."""
_MOVES = (0.3, 0.7, 1.0)
_KEPT = 6
"""Members of the last population that are refined."""
_STEPS = 12
_NARROWINGS = 3
_WIDTH = 1.0
"""Standard deviations that the differences of the curvature reach out."""
OVERCONFIDENCE = 2.0
"""The cost's curvature divided by this is honest information; chosen for coverage on training meshes. For the same
reason the prior counts this many times when distant corrections are compared."""
_FARTHEST = 3.0
"""Standard deviations of the prior, per axis: a calibration is not wrong by more."""
_UNBELIEVABLE = 1e3
_SEARCH_BEAMS = 120
_MAX_BEAMS = 320
"""Beams used to search, and to refine and take the curvature; the winner is refined on all."""


def solve(problem: Problem) -> Solution:
    """The best correction and its covariance.

    Other corrections that agree nearly as well widen the covariance by their distance, as likely as they are.
    """
    thin = _thinned(problem, _MAX_BEAMS)
    found = _search(_thinned(problem, _SEARCH_BEAMS))
    candidates = np.array([refine(x, 1.0, problem.prior, *thin.arguments()) for x in found])
    cost = _believable(candidates, 1.0, thin)
    x: Array = refine(candidates[np.argmin(cost)], 1.0, problem.prior, *problem.arguments())
    likelihood = np.exp((cost.min() - cost) / OVERCONFIDENCE)
    apart = candidates - x
    spread = (likelihood[:, None] * apart).T @ apart / likelihood.sum()
    return Solution(x, covariance_at(thin, x) + spread)


def _thinned(problem: Problem, most: int) -> Problem:
    step = max(1, -(-len(problem.beams) // most))
    beams = problem.beams[::step].copy()
    beams[:, 7] *= step
    return replace(problem, beams=beams)


def _believable(xs: Array, factor: float, problem: Problem) -> Array:
    """The costs of xs (m, 6) when distant corrections are compared: beyond _FARTHEST of the prior none is believed."""
    too_far = (np.abs(xs) * np.sqrt(problem.prior) > _FARTHEST).any(axis=1)
    cost = costs(xs, factor, OVERCONFIDENCE * problem.prior, *problem.arguments())
    return np.asarray(cost + np.where(too_far, _UNBELIEVABLE, 0.0), dtype=np.float64)


def _search(problem: Problem) -> Array:
    """The best few corrections (_KEPT, 6) of a population that follows the cost from widened noise to the true one.

    Annealed sequential Monte Carlo: resampled by likelihood at each noise factor, then moved by differential-evolution
    Metropolis steps (ter Braak 2006), which take their directions from the population itself. The draws are fixed.
    """
    rng = np.random.default_rng(0)
    xs: Array = rng.standard_normal((_DRAWS, 6)) / np.sqrt(problem.prior)
    xs[0] = 0.0
    for factor, moves in _ANNEALING:
        cost = _believable(xs, factor, problem)
        likelihood = np.exp((cost.min() - cost) / OVERCONFIDENCE)
        steps = (np.arange(_POPULATION) + rng.uniform()) / _POPULATION
        chosen = np.searchsorted(np.cumsum(likelihood) / likelihood.sum(), steps).clip(max=len(xs) - 1)
        xs, cost = xs[chosen], cost[chosen]
        for _ in range(moves):
            a, b = rng.integers(_POPULATION, size=(2, _POPULATION))
            length = rng.choice(_MOVES, size=(_POPULATION, 1))
            jitter = 0.05 * rng.standard_normal(xs.shape) * factor / 4 / np.sqrt(problem.prior)
            proposed = xs + length * (xs[a] - xs[b]) + jitter
            new_cost = _believable(proposed, factor, problem)
            accepted = np.log(rng.uniform(1e-300, 1, _POPULATION)) < (cost - new_cost) / OVERCONFIDENCE
            xs[accepted], cost[accepted] = proposed[accepted], new_cost[accepted]
    _, first = np.unique(xs.round(6), axis=0, return_index=True)
    return xs[first[np.argsort(cost[first], kind="stable")[:_KEPT]]]


@njit(cache=True, nogil=True)
def refine(
    x: Array, factor: float, prior: Array, beams: Array, centroid: Array, optics: Array, table: Array, noise: Array,
    pixels: NDArray[np.float32], footprint: NDArray[np.float32], frame: Array,
) -> Array:  # fmt: skip
    """Levenberg-Marquardt on robust weights from x (6,), at noise widened by `factor`."""
    damping = 1e-3
    information, gradient, cost = normal_equations(
        x, factor, prior, beams, centroid, optics, table, noise, pixels, footprint, frame
    )
    for _ in range(_STEPS):
        damped = information.copy()
        for k in range(6):
            damped[k, k] *= 1.0 + damping
        step: Array = np.linalg.solve(damped, -gradient).astype(np.float64)
        turn: Array = vector_of(rotation_of(step[:3]) @ rotation_of(x[:3]))
        moved = np.concatenate((turn, x[3:] + step[3:]))
        new_information, new_gradient, new_cost = normal_equations(
            moved, factor, prior, beams, centroid, optics, table, noise, pixels, footprint, frame
        )
        if new_cost < cost:
            gain = cost - new_cost
            x, information, gradient, cost = moved, new_information, new_gradient, new_cost
            damping = max(damping / 5, 1e-6)
            if gain < 1e-4:
                break
        else:
            damping *= 8
            if damping > 1e4:
                break
    return x


def covariance_at(problem: Problem, x: Array) -> Array:
    """The covariance (6, 6) that the cost's curvature at x (6,) stands for, at the scale of that covariance.

    From twice the width that the derivatives at x give: wider, the saturated cost would look flat; narrower, its
    roughness would look like curvature.
    """
    prior = np.diag(problem.prior)
    information, _, _ = normal_equations(x, 1.0, problem.prior, *problem.arguments())
    covariance = _inverse((information - prior) / (4 * OVERCONFIDENCE) + prior)
    for _ in range(_NARROWINGS):
        covariance = _inverse(curvature(problem, x, covariance))
    return covariance


def _inverse(matrix: Array) -> Array:
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)


def curvature(problem: Problem, x: Array, covariance: Array) -> Array:
    """Honest information (6, 6): the quadratic that fits the cost best over the spread of `covariance` (6, 6) around x.

    Least squares over fixed antithetic draws in whitened coordinates, so that odd terms cancel and the roughness of the
    cost averages out; no direction is given less than the prior's information.
    """
    root = np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
    spread = _PAIRS @ root.T
    cost = costs(np.concatenate([x + spread, x - spread]), 1.0, np.zeros(6), *problem.arguments())
    even = 0.5 * (cost[: len(spread)] + cost[len(spread) :])
    coefficients = _FIT @ even
    hessian = np.zeros((6, 6))
    hessian[_UPPER] = coefficients[1:]
    hessian = hessian + hessian.T
    values, turn = np.linalg.eigh(hessian)
    hessian = (turn * np.maximum(values, 0.0)) @ turn.T / OVERCONFIDENCE
    whiten = _inverse(root)
    return np.asarray(whiten.T @ hessian @ whiten + np.diag(problem.prior), dtype=np.float64)


_UPPER = np.triu_indices(6)
_PAIRS = np.random.default_rng(2).standard_normal((56, 6)) * _WIDTH
_FIT = np.linalg.pinv(np.column_stack([np.ones(len(_PAIRS)), _PAIRS[:, _UPPER[0]] * _PAIRS[:, _UPPER[1]]]))
