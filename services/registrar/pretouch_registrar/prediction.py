"""What a scan that has not been made yet would leave uncertain: simulated on what the camera saw."""

from __future__ import annotations

from functools import cache

import numpy as np
from numba import njit
from scipy.stats import norm, qmc

from pretouch.geometry import Array
from pretouch.tof import Scan, Sensor
from pretouch.trajectory import Trajectory
from pretouch_registrar.engines.laplace import covariance_after, curvature_draws
from pretouch_registrar.engines.objective import supposing_likeliest
from pretouch_registrar.engines.problem import Beams, Problem, beams_of, patches_among
from pretouch_registrar.ray_casting import cast

_TRUTHS, _TRUTHS_AFTER = 12, 8
"""Corrections drawn from the estimate that are taken as the truth in turn, before the first scan and after it."""
_BEAMS = 30
"""Beams of a candidate that are simulated; about as many samples as the engine takes to be independent."""
_WIDE_BEAMS = 12
"""The same for a wide beam, whose spots overlap."""


def predicted_covariance(problem: Problem, x: Array, covariance: Array, path: Trajectory, sensor: Sensor) -> Array:
    """The covariance (6, 6) that the estimate x (6,) with `covariance` (6, 6) would have after a scan along `path`.

    The mean over truths drawn from the estimate: for each, the beams are cast onto the camera's surface moved there,
    and the scan's cost around that truth says how well it would be found. The mean is taken of the covariances, since a
    scan that may miss the object is worth what it leaves uncertain then. What no scan averages out stays, and where
    earlier scans were, a further one tells less.
    """
    origins, directions = _beams(path, sensor, _WIDE_BEAMS if problem.wide else _BEAMS)
    draws = _draws(_TRUTHS_AFTER if len(problem.beams.weights) else _TRUTHS)
    truths = x + draws @ np.linalg.cholesky(covariance).T
    ranges = cast(problem, np.concatenate([x[None], truths]), origins, directions, sensor.range_min)
    expected, *returned = np.where(ranges <= sensor.range_max, ranges, np.nan)
    samples = max(path.duration * sensor.rate * len(sensor.tip_T_module) / len(origins), 1.0)
    earlier = patches_among(problem.beams, problem.shared)
    weights = beams_of([Scan(origins, directions, expected)], problem.shared, samples, earlier).weights
    seen = beams_of([Scan(origins, directions, each) for each in returned], problem.shared)
    beams = seen._replace(weights=np.tile(weights, len(truths)))
    precision = np.asarray(np.linalg.inv(_without(covariance, problem.systematic)), dtype=np.float64)
    normal, fit = curvature_draws()
    simulated = supposing_likeliest(x, problem).free()
    simulated = simulated._replace(beams=beams, temperature=problem.temperature_with(float(weights.sum())))
    mean: Array = _mean_covariance(truths, simulated, precision, normal, np.ascontiguousarray(fit[1:]))
    return np.asarray(mean + problem.systematic, dtype=np.float64)


def _without(covariance: Array, systematic: Array) -> Array:
    """What is left of a covariance (6, 6) without a part (6, 6) of it; a tenth at least, should it not be a part."""
    root = np.linalg.cholesky(covariance)
    whiten = np.linalg.inv(root)
    values, vectors = np.linalg.eigh(np.eye(6) - whiten @ systematic @ whiten.T)
    return np.asarray(root @ (vectors * np.maximum(values, 0.1)) @ vectors.T @ root.T, dtype=np.float64)


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


@njit(cache=True, nogil=True)
def _mean_covariance(truths: Array, problem: Problem, precision: Array, draws: Array, fit: Array) -> Array:
    """Mean (6, 6) over truths (t, 6) of the covariance that each one's beams leave of inverse `precision`.

    The beams of `problem`, as many for each truth, follow each other in the order of the truths.
    """
    total = np.zeros((6, 6))
    beams = problem.beams
    count = beams.weights.shape[0] // truths.shape[0]
    for k in range(truths.shape[0]):
        own = slice(k * count, (k + 1) * count)
        seen = Beams(
            beams.points[own], beams.directions[own], beams.returned[own], beams.weights[own], beams.ranges[own]
        )
        each = Problem(
            seen, problem.target, problem.noise, problem.cone, problem.prior, problem.temperature, problem.shared,
            problem.systematic, problem.free_turn,
        )  # fmt: skip
        total += covariance_after(truths[k], each, precision, draws, fit)
    return total / truths.shape[0]
