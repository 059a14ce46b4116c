"""One correction and its neighbourhood: the best one nearby, and how sharply the cost singles it out."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch_registrar.engines.agreement import normal_equations, spread_costs
from pretouch_registrar.engines.problem import Problem
from pretouch_registrar.engines.turns import rotation_of, vector_of

_STEPS = 12
_ROUNDS = 2


@njit(cache=True, nogil=True)
def refine(
    x: Array, factor: float, prior: Array, beams: Array, centroid: Array, optics: Array, table: Array, noise: Array,
    rays: Array, pixels: NDArray[np.float32], footprint: NDArray[np.float32], frame: Array,
) -> Array:  # fmt: skip
    """Levenberg-Marquardt on robust weights from x (6,), at noise widened by `factor`."""
    damping = 1e-3
    information, gradient, cost = normal_equations(
        x, factor, prior, beams, centroid, optics, table, noise, rays, pixels, footprint, frame
    )
    for _ in range(_STEPS):
        damped = information.copy()
        for k in range(6):
            damped[k, k] *= 1.0 + damping
        step: Array = np.linalg.solve(damped, -gradient).astype(np.float64)
        turn: Array = vector_of(rotation_of(step[:3]) @ rotation_of(x[:3]))
        moved = np.concatenate((turn, x[3:] + step[3:]))
        new_information, new_gradient, new_cost = normal_equations(
            moved, factor, prior, beams, centroid, optics, table, noise, rays, pixels, footprint, frame
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


def covariance_at(problem: Problem, x: Array, temperature: float) -> Array:
    """The covariance (6, 6) that the cost's curvature at x (6,) stands for, at the scale of that covariance.

    From the width that half the derivatives' information gives: wider, the saturated cost would look flat; narrower,
    its roughness would look like curvature.
    """
    information, _, _ = normal_equations(x, 1.0, np.zeros(6), *problem.arguments())
    covariance = _inverse(information / (2 * temperature) + np.diag(problem.prior))
    for _ in range(_ROUNDS):
        covariance = _inverse(_curvature(problem, x, covariance) / temperature + np.diag(problem.prior))
    return covariance


def _inverse(matrix: Array) -> Array:
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)


def _curvature(problem: Problem, x: Array, covariance: Array) -> Array:
    """Information (6, 6): the quadratic that fits the cost best over the spread of `covariance` (6, 6) around x.

    Least squares over fixed antithetic draws in whitened coordinates, so that odd terms cancel and the roughness of the
    cost averages out.
    """
    root = np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
    spread = _PAIRS @ root.T
    cost = spread_costs(np.concatenate([x + spread, x - spread]), 1.0, problem)
    even = 0.5 * (cost[: len(spread)] + cost[len(spread) :])
    coefficients = _FIT @ even
    hessian = np.zeros((6, 6))
    hessian[_UPPER] = coefficients[1:]
    hessian = hessian + hessian.T
    values, turn = np.linalg.eigh(hessian)
    hessian = (turn * np.maximum(values, 0.0)) @ turn.T
    whiten = _inverse(root)
    return np.asarray(whiten.T @ hessian @ whiten, dtype=np.float64)


_UPPER = np.triu_indices(6)
_PAIRS = np.random.default_rng(2).standard_normal((56, 6))
_FIT = np.linalg.pinv(np.column_stack([np.ones(len(_PAIRS)), _PAIRS[:, _UPPER[0]] * _PAIRS[:, _UPPER[1]]]))
