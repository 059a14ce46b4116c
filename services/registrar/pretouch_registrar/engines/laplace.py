"""Laplace's approximation: the covariance that the cost's curvature at a correction stands for.

The curvature is that of the quadratic that fits the cost best over the spread of a covariance around the correction:
least squares over fixed antithetic draws in whitened coordinates, so that odd terms cancel and the roughness of the
cost averages out.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numba import njit

from pretouch.geometry import Array
from pretouch_registrar.engines.objective import energies, normal_equations, spread_energies, supposing_likeliest
from pretouch_registrar.engines.problem import Problem
from pretouch_registrar.engines.resources import Resources

_ROUNDS = 2
_PAIRS = 56
"""Antithetic pairs of corrections that the curvature is taken from, each round."""


@cache
def curvature_draws() -> tuple[Array, Array]:
    """Standard normal draws (_PAIRS, 6), and the least squares fit (22, _PAIRS) of a quadratic to values at them.

    Its constant, then the coefficients of the products of components i <= j, row by row.
    """
    draws = np.random.default_rng(2).standard_normal((_PAIRS, 6))
    first, second = np.triu_indices(6)
    design = np.column_stack([np.ones(_PAIRS), draws[:, first] * draws[:, second]])
    return draws, np.linalg.pinv(design)


def covariance_at(problem: Problem, x: Array, resources: Resources) -> Array:
    """The covariance (6, 6) that the energy's curvature at x (6,) stands for, at the scale of that covariance.

    The prior counts as a normal one. From the width that half the derivatives' information gives: wider, the saturated
    cost would look flat; narrower, its roughness would look like curvature.
    """
    draws, fit = curvature_draws()
    free = problem.free()
    information, _, _ = normal_equations(x, supposing_likeliest(x, free))
    covariance = np.asarray(np.linalg.inv(information / 2 + np.diag(problem.prior)), dtype=np.float64)
    for _ in range(_ROUNDS):
        root = np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
        spread = draws @ root.T
        levels = spread_energies(np.concatenate([x + spread, x - spread]), free, resources)
        coefficients = fit @ (0.5 * (levels[:_PAIRS] + levels[_PAIRS:]))
        covariance = _covariance_of_quadratic(coefficients[1:], root, np.diag(problem.prior))
    return covariance


def _covariance_of_quadratic(coefficients: Array, root: Array, precision: Array) -> Array:
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


_compiled_covariance_of_quadratic = njit(cache=True, nogil=True)(_covariance_of_quadratic)


@njit(cache=True, nogil=True)
def covariance_after(x: Array, problem: Problem, precision: Array, draws: Array, fit: Array) -> Array:
    """The covariance (6, 6) at x (6,) of a normal density with `precision` (6, 6) after the beams of `problem`.

    As `covariance_at`, compiled and on one thread, with the draws and the fit (21, _PAIRS), less the constant's row, of
    `curvature_draws`; at first over the spread of four times the covariance that the derivatives give,
    which see neither the edges nor where the cost saturates.
    """
    information, _, _ = normal_equations(x, problem)
    covariance = np.linalg.inv(information / 4 + precision)
    for _ in range(_ROUNDS):
        root = np.linalg.cholesky(covariance)
        spread = draws @ root.T
        levels = energies(np.concatenate((x + spread, x - spread)), problem)
        coefficients = fit @ (0.5 * (levels[:_PAIRS] + levels[_PAIRS:]))
        covariance = _compiled_covariance_of_quadratic(coefficients, root, precision)
    result: Array = covariance.astype(np.float64)
    return result
