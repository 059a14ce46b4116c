"""Predicts the covariance after a scan that has not been made yet, by simulating it on the camera's surface."""

from __future__ import annotations

from functools import cache

import numpy as np
from numba import njit
from scipy.stats import norm, qmc

from pretouch.geometry import Array
from pretouch.tof import Scan, Sensor
from pretouch.trajectory import Trajectory
from pretouch_registrar.engines.laplace import make_curvature_draws, update_covariance
from pretouch_registrar.engines.objective import assume_likeliest_hypothesis
from pretouch_registrar.engines.registration_problem import Beams, RegistrationProblem, collect_beams, find_beam_patches
from pretouch_registrar.ray_casting import cast_rays

_TRUTHS, _TRUTHS_AFTER = 12, 8
"""Corrections drawn from the estimate, each taken as the truth in turn: before the first scan, and after it."""
_BEAMS = 30
"""Beams of a candidate that are simulated: about its effective number of samples."""
_WIDE_BEAMS = 12
"""The same for a wide beam, whose spots overlap."""


def predict_covariance(
    problem: RegistrationProblem, x: Array, covariance: Array, path: Trajectory, sensor: Sensor
) -> Array:
    """The covariance (6, 6) that the estimate x (6,) with `covariance` (6, 6) would have after a scan along `path`.

    The mean over truths drawn from the estimate: for each, the beams are cast on the camera's surface as moved by it,
    and the covariance follows from the curvature of the scan's cost around that truth. Covariances are averaged, not
    information, so that the chance that a scan misses the object counts. Systematic errors remain, and samples where
    earlier scans were add less information.
    """
    origins, directions = _sample_beams(path, sensor, _WIDE_BEAMS if problem.wide else _BEAMS)
    draws = _draw_normal(_TRUTHS_AFTER if len(problem.beams.weights) else _TRUTHS)
    truths = x + draws @ np.linalg.cholesky(covariance).T
    ranges = cast_rays(problem, np.concatenate([x[None], truths]), origins, directions, sensor.range_min)
    expected, *returned = np.where(ranges <= sensor.range_max, ranges, np.nan)
    samples = max(path.duration * sensor.rate * len(sensor.tip_T_module) / len(origins), 1.0)
    earlier = find_beam_patches(problem.beams, problem.shared)
    weights = collect_beams([Scan(origins, directions, expected)], problem.shared, samples, earlier).weights
    seen = collect_beams([Scan(origins, directions, each) for each in returned], problem.shared)
    beams = seen._replace(weights=np.tile(weights, len(truths)))
    precision = np.asarray(
        np.linalg.inv(_subtract_covariance(covariance, problem.systematic_covariance)), dtype=np.float64
    )
    normal, fit = make_curvature_draws()
    simulated = assume_likeliest_hypothesis(x, problem).without_prior()
    simulated = simulated._replace(beams=beams, temperature=problem.predict_temperature(float(weights.sum())))
    mean: Array = _average_covariance(truths, simulated, precision, normal, np.ascontiguousarray(fit[1:]))
    return np.asarray(mean + problem.systematic_covariance, dtype=np.float64)


def _subtract_covariance(covariance: Array, systematic: Array) -> Array:
    """A covariance (6, 6) less its `systematic` part (6, 6); at least a tenth of it is left in each direction."""
    root = np.linalg.cholesky(covariance)
    whiten = np.linalg.inv(root)
    values, vectors = np.linalg.eigh(np.eye(6) - whiten @ systematic @ whiten.T)
    return np.asarray(root @ (vectors * np.maximum(values, 0.1)) @ vectors.T @ root.T, dtype=np.float64)


def _sample_beams(path: Trajectory, sensor: Sensor, count: int) -> tuple[Array, Array]:
    """Origins and directions (n, 3) of about `count` beams, spread over the path and the sensor's modules."""
    modules = np.stack([pose.matrix for pose in sensor.tip_T_module])
    poses = path.sampled(min(sensor.rate, (count - 1) / max(path.duration, 1e-9))).base_T_tip
    base_T_module = (poses[:, None] @ modules[None]).reshape(-1, 4, 4)
    chosen = base_T_module[np.linspace(0, len(base_T_module) - 1, min(count, len(base_T_module))).astype(np.intp)]
    return np.ascontiguousarray(chosen[:, :3, 3]), np.ascontiguousarray(chosen[:, :3, 2])


@cache
def _draw_normal(count: int) -> Array:
    """(count, 6) antithetic standard normal draws from a Sobol sequence; `count` is even, at most 16."""
    half = norm.ppf(0.001 + 0.998 * qmc.Sobol(6, seed=3).random(8))[: count // 2]
    return np.concatenate([half, -half])


@njit(cache=True, nogil=True)
def _average_covariance(
    truths: Array, problem: RegistrationProblem, precision: Array, draws: Array, fit: Array
) -> Array:
    """Mean (6, 6) over truths (t, 6) of the covariance after each one's beams, given `precision` (6, 6) before them.

    `problem` holds the beams of all truths, equally many for each, in the order of the truths.
    """
    total = np.zeros((6, 6))
    beams = problem.beams
    count = beams.weights.shape[0] // truths.shape[0]
    for k in range(truths.shape[0]):
        own = slice(k * count, (k + 1) * count)
        seen = Beams(
            beams.points[own], beams.directions[own], beams.returned[own], beams.weights[own], beams.ranges[own]
        )
        each = RegistrationProblem(
            seen, problem.target, problem.noise, problem.cone, problem.prior, problem.temperature, problem.shared,
            problem.systematic_covariance, problem.free_turn,
        )  # fmt: skip
        total += update_covariance(truths[k], each, precision, draws, fit)
    return total / truths.shape[0]
