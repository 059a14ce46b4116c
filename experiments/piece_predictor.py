"""Predictions for many pieces at once: each beam's quadratic cost is fitted once, and pieces add those of their beams."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from pretouch_registrar import prediction
from pretouch_registrar.engines import so3
from pretouch_registrar.engines.compiled import NO_REFERENCES
from pretouch_registrar.engines.correction import carry_back, turn_back
from pretouch_registrar.engines.registration_problem import collect_beams, find_beam_patches
from pretouch_registrar.engines.residuals.miss import miss_cost
from pretouch_registrar.engines.residuals.point import PointResiduals, compute_half_square, point_residual
from pretouch_registrar.engines.robust_kernel import robust_cost
from pretouch_registrar.ray_casting import cast_rays
from scipy.stats import norm, qmc

from pretouch.geometry import Array
from pretouch.tof import Scan
from pretouch.trajectory import Trajectory

FIRST, SECOND = np.triu_indices(6)
SPACING = 0.2
"""s between simulated beams."""


PAIRS = 32
"""Antithetic pairs that each beam's quadratic is fitted to."""


def quadratic_draws() -> tuple[Array, Array]:
    draws = np.random.default_rng(2).standard_normal((PAIRS, 6))
    design = np.column_stack([np.ones(PAIRS), draws[:, FIRST] * draws[:, SECOND]])
    return draws, np.linalg.pinv(design)


def draw_normal(count: int, seed: int) -> Array:
    half = norm.ppf(0.001 + 0.998 * qmc.Sobol(6, seed=seed).random(count // 2))
    return np.concatenate([half, -half])


@njit(cache=True, nogil=True, error_model="numpy", **NO_REFERENCES)
def _add(xk, r, sign, problem, points, returned, directions, out, fit, d, coefficients):
    target, noise = problem.target, problem.noise
    for n in range(points.shape[0]):
        point = carry_back(xk, r, target.centroid, points, n)
        direction = turn_back(r, directions, n)
        if returned[n]:
            cap, beyond = point_residual(point, direction, target, noise, out)
            cost = beyond + robust_cost(compute_half_square(out), cap)
        else:
            cost = miss_cost(point, direction, target, noise)
        for c in range(21):
            coefficients[n, c] += 0.5 * fit[c, d] * cost


@njit(cache=True, nogil=True, error_model="numpy")
def _fit_beams(truths, spread, problem, points, returned, directions, fit):
    """(t, n, 21)."""
    result = np.zeros((truths.shape[0], points.shape[1], 21))
    out = PointResiduals(np.zeros(3), np.zeros((3, 3)))
    for k in range(truths.shape[0]):
        for d in range(spread.shape[0]):
            for sign in (-1.0, 1.0):
                xk = truths[k] + sign * spread[d]
                r = so3.exp(xk[:3])
                _add(xk, r, sign, problem, points[k], returned[k], directions, out, fit, d, result[k])
    return result


class BeamModel:
    """The state of a session, and beams along paths with their quadratics at each truth."""

    def __init__(self, problem, x, covariance, paths: Sequence[Trajectory], sensor, root, truths: int, seed: int) -> None:
        self.problem, self.x, self.sensor = problem, x, sensor
        self.root, self.whiten = root, np.linalg.inv(root)
        times = [np.arange(0.5 * SPACING, max(p.duration, SPACING), SPACING) for p in paths]
        poses = np.concatenate([p.at(np.minimum(t, p.t[-1])) for p, t in zip(paths, times, strict=True)])
        self.path = np.repeat(np.arange(len(paths)), [len(t) for t in times])
        self.time = np.concatenate(times)
        self.start = np.searchsorted(self.path, np.arange(len(paths)))
        o, d = np.ascontiguousarray(poses[:, :3, 3]), np.ascontiguousarray(poses[:, :3, 2])
        self.origins, self.directions = o, d
        self.truths = x + draw_normal(truths, seed) @ np.linalg.cholesky(covariance).T
        ranges = cast_rays(problem, np.concatenate([x[None], self.truths]), o, d, sensor.range_min)
        ranges = np.where(ranges <= sensor.range_max, ranges, np.nan)
        self.expected = ranges[0]
        back = np.isfinite(ranges[1:])
        points = o + np.where(back, ranges[1:], 0.0)[..., None] * d
        draws, fit = quadratic_draws()
        self.coefficients = _fit_beams(
            self.truths, np.ascontiguousarray(draws @ root.T), problem.without_prior(), points, back, d, np.ascontiguousarray(fit[1:])
        )
        self.precision = np.linalg.inv(prediction._subtract_covariance(covariance, problem.systematic_covariance))
        self.earlier = find_beam_patches(problem.beams, problem.shared)
        self.returned = back

    def information(self, path: int, start: float, end: float) -> Array:
        """(t, 6, 6) the positive curvature at each truth of the beams of a piece."""
        n = np.flatnonzero((self.path == path) & (self.time >= start - 1e-9) & (self.time <= end + 1e-9))
        samples = max((end - start) * self.sensor.rate / len(n), 1.0)
        scan = Scan(self.origins[n], self.directions[n], self.expected[n])
        weights = collect_beams([scan], self.problem.shared, samples, self.earlier).weights
        temperature = self.problem.predict_temperature(float(weights.sum()))
        c = np.einsum("tnc,n->tc", self.coefficients[:, n], weights / temperature)
        h = np.zeros((len(c), 6, 6))
        h[:, FIRST, SECOND] += c
        h[:, SECOND, FIRST] += c
        values, turn = np.linalg.eigh(h)
        h = (turn * np.maximum(values, 0.0)[:, None]) @ turn.swapaxes(1, 2)
        return self.whiten.T @ h @ self.whiten

    def covariance(self, path: int, start: float, end: float) -> Array:
        after = np.linalg.inv(self.information(path, start, end) + self.precision)
        return after.mean(axis=0) + self.problem.systematic_covariance
