"""What a scan that has not been made yet would leave uncertain: simulated on what the camera saw."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numba import njit
from scipy.stats import norm, qmc

from pretouch.geometry import Array
from pretouch.tof import Scan, Sensor
from pretouch.trajectory import Trajectory
from pretouch_registrar.cast import cast
from pretouch_registrar.engines.agreement import costs, normal_equations
from pretouch_registrar.engines.posterior import temperature
from pretouch_registrar.engines.problem import Problem, beam_rows

_TRUTHS, _TRUTHS_AFTER = 12, 8
"""Corrections drawn from the estimate that are taken as the truth in turn, before the first scan and after it."""
_BEAMS = 30
"""Beams of a candidate that are simulated; about as many samples as the engine takes to be independent."""
_WIDE_BEAMS = 12
"""The same for a wide beam, whose spots overlap."""
_ROUNDS = 2
_PAIRS = 56
"""Antithetic pairs of corrections that the curvature is taken from, each round."""


def predicted_covariance(problem: Problem, x: Array, covariance: Array, path: Trajectory, sensor: Sensor) -> Array:
    """The covariance (6, 6) that the estimate x (6,) with `covariance` (6, 6) would have after a scan along `path`.

    The mean over truths drawn from the estimate: for each, the beams are cast onto the camera's surface moved there,
    and the scan's cost around that truth says how well it would be found. The mean is taken of the covariances, since a
    scan that may miss the object is worth what it leaves uncertain then.
    """
    origins, directions = _beams(path, sensor, _WIDE_BEAMS if len(problem.rays) else _BEAMS)
    draws = _draws(_TRUTHS_AFTER if len(problem.beams) else _TRUTHS)
    truths = x + draws @ np.linalg.cholesky(covariance).T
    ranges = cast(problem, truths, origins, directions, sensor.range_min)
    returned = np.where(ranges <= sensor.range_max, ranges, np.nan)
    rows = beam_rows([Scan(origins, directions, each) for each in returned], sensor).reshape(*ranges.shape, -1)
    cold = temperature(np.concatenate([problem.beams, rows[0]]))
    precision = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
    mean: Array = _mean_covariance(truths, precision, rows, cold, *_curvature_draws(), problem.arguments()[1:])
    return mean


def _beams(path: Trajectory, sensor: Sensor, count: int) -> tuple[Array, Array]:
    """Origins and directions (n, 3) of about `count` beams, spread over the path and the sensor's modules."""
    modules = np.stack([pose.matrix for pose in sensor.tip_T_module])
    poses = path.sampled(min(sensor.rate, (count - 1) / max(path.duration, 1e-9))).base_T_tip
    base_T_module = (poses[:, None] @ modules[None]).reshape(-1, 4, 4)
    chosen = base_T_module[np.linspace(0, len(base_T_module) - 1, min(count, len(base_T_module))).astype(np.intp)]
    return np.ascontiguousarray(chosen[:, :3, 3]), np.ascontiguousarray(chosen[:, :3, 2])


@cache
def _draws(count: int) -> Array:
    """(count, 6) standard normal draws, spread evenly, each with its opposite; `count` is even, at most 16."""
    half = norm.ppf(0.001 + 0.998 * qmc.Sobol(6, seed=3).random(8))[: count // 2]
    return np.concatenate([half, -half])


@cache
def _curvature_draws() -> tuple[Array, Array]:
    """Standard normal draws (_PAIRS, 6), and the least squares fit (21, _PAIRS) of a quadratic to values at them."""
    draws = np.random.default_rng(2).standard_normal((_PAIRS, 6))
    first, second = np.triu_indices(6)
    design = np.column_stack([np.ones(_PAIRS), draws[:, first] * draws[:, second]])
    return draws, np.ascontiguousarray(np.linalg.pinv(design)[1:])


@njit(cache=True, nogil=True)
def _mean_covariance(
    truths: Array, precision: Array, rows: Array, cold: float, draws: Array, fit: Array, scene: tuple[Any, ...]
) -> Array:
    """Mean (6, 6) over truths (t, 6) of the covariance that beams `rows` (t, n, 9) leave of inverse `precision`.

    Costs are divided by `cold`.

    `scene` is what the kernels of `agreement` take after the beams. The cost's curvature is taken over the spread of a
    covariance, at first four times that of the derivatives, which see neither the edges nor where the cost saturates,
    then that of the round before.
    """
    free = np.zeros(6)
    total = np.zeros((6, 6))
    for k in range(truths.shape[0]):
        information, _, _ = normal_equations(truths[k], 1.0, free, rows[k], *scene)
        covariance = np.linalg.inv(information / (4 * cold) + precision)
        for _ in range(_ROUNDS):
            root = np.linalg.cholesky(covariance)
            spread = draws @ root.T
            cost = costs(np.concatenate((truths[k] + spread, truths[k] - spread)), 1.0, free, rows[k], *scene)
            coefficients = fit @ (0.5 * (cost[: len(spread)] + cost[len(spread) :]))
            hessian = np.zeros((6, 6))
            n = 0
            for i in range(6):
                for j in range(i, 6):
                    hessian[i, j] += coefficients[n]
                    hessian[j, i] += coefficients[n]
                    n += 1
            values, turn = np.linalg.eigh(hessian)
            hessian = (turn * np.maximum(values, 0.0)) @ turn.T / cold
            whiten = np.linalg.inv(root)
            covariance = np.linalg.inv(whiten.T @ hessian @ whiten + precision)
        total += covariance
    return total / truths.shape[0]
