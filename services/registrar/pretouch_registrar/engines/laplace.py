"""The Laplace approximation: the covariance from the curvature of the cost at a correction.

The curvature is that of a quadratic that is fitted to the cost by least squares, over fixed antithetic draws in
coordinates whitened by the covariance, so that odd terms cancel and the roughness of the cost averages out.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numba import njit

from pretouch.geometry import Array
from pretouch_registrar.engines.objective import (
    assume_likeliest_hypothesis,
    compute_costs,
    compute_energies_in_parallel,
    linearize,
)
from pretouch_registrar.engines.registration_problem import RegistrationProblem
from pretouch_registrar.engines.resources import Resources

_ROUNDS = 2
_PAIRS = 56
"""Antithetic pairs of corrections that the quadratic is fitted to, in each round."""


@cache
def make_curvature_draws(pairs: int = _PAIRS) -> tuple[Array, Array]:
    """Standard normal draws (pairs, 6), and the matrix (22, pairs) that fits a quadratic to values at them.

    It gives the constant, then the coefficients of the products of components i <= j, row by row.
    """
    draws = np.random.default_rng(2).standard_normal((pairs, 6))
    first, second = np.triu_indices(6)
    design = np.column_stack([np.ones(pairs), draws[:, first] * draws[:, second]])
    return draws, np.linalg.pinv(design)


def compute_covariance(problem: RegistrationProblem, x: Array, resources: Resources) -> Array:
    """The covariance (6, 6) from the energy's curvature at x (6,), at the scale of that covariance.

    The prior is taken to be normal. The first scale is that of half the Gauss-Newton information: with a wider one the
    saturated cost would look flat, and with a narrower one its roughness would look like curvature.
    """
    draws, fit = make_curvature_draws()
    free = problem.without_prior()
    information, _, _ = linearize(x, assume_likeliest_hypothesis(x, free))
    covariance = np.asarray(np.linalg.inv(information / 2 + problem.prior.precision), dtype=np.float64)
    for _ in range(_ROUNDS):
        root = np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
        spread = draws @ root.T
        levels = compute_energies_in_parallel(np.concatenate([x + spread, x - spread]), free, resources)
        coefficients = fit @ (0.5 * (levels[:_PAIRS] + levels[_PAIRS:]))
        covariance = covariance_of_quadratic(coefficients[1:], root, problem.prior.precision)
    return covariance


def covariance_of_quadratic(coefficients: Array, root: Array, precision: Array) -> Array:
    """The covariance (6, 6) of a normal density with `precision` (6, 6) after a quadratic cost is added.

    Args:
        coefficients: (21,) of the products of components i <= j, row by row, in coordinates whitened by `root`.
            Negative curvature counts as none.
        root: (6, 6), the Cholesky factor of the covariance over which the quadratic was fitted.
    """
    hessian = np.zeros((6, 6))
    n = 0
    for i in range(6):
        for j in range(i, 6):
            hessian[i, j] += coefficients[n]
            hessian[j, i] += coefficients[n]
            n += 1
    values, turn = np.linalg.eigh(hessian)
    hessian = (turn * np.maximum(values, 0.0)) @ turn.T
    whiten = np.linalg.inv(root)
    covariance: Array = np.linalg.inv(whiten.T @ hessian @ whiten + precision)
    return covariance


compiled_covariance_of_quadratic = njit(cache=True, nogil=True)(covariance_of_quadratic)


@njit(cache=True, nogil=True)
def fit_quadratics(x: Array, problem: RegistrationProblem, root: Array, draws: Array, fit: Array) -> Array:
    """(n, 21): the quadratic part of the cost of each of the problem's n beams around x (6,).

    The coefficients are those of `covariance_of_quadratic`, for a weight and a temperature of 1.

    Args:
        root: (6, 6), Cholesky factor of the covariance over which it is fitted.
        draws, fit: of `make_curvature_draws`, `fit` without the constant's row.
    """
    pairs, spread = draws.shape[0], draws @ root.T
    costs = compute_costs(np.concatenate((x + spread, x - spread)), problem)
    coefficients: Array = (fit @ (0.5 * (costs[:pairs] + costs[pairs:]))).T
    return coefficients
