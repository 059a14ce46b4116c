"""Predicts what scans that have not been made yet would leave and return, by simulating them on the camera's surface.

Corrections are drawn from the estimate, and each is taken as the truth in turn. Beams along the whole path are cast
once for each truth, and the quadratic that approximates each beam's cost around it is fitted once, over a covariance
between the present one and that after the whole path. The cost of a piece's samples is then the weighted sum of its
beams' quadratics, and costs no more than the inverse of a matrix.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.stats import norm, qmc

from pretouch.geometry import Array
from pretouch.scan_prediction import Candidate
from pretouch.tof import Sensor
from pretouch_registrar.engines.laplace import compiled_covariance_of_quadratic, fit_quadratics, make_curvature_draws
from pretouch_registrar.engines.objective import assume_likeliest_hypothesis, linearize
from pretouch_registrar.engines.patches import Patches, group_samples
from pretouch_registrar.engines.registration_problem import Beams, RegistrationProblem
from pretouch_registrar.known_misses import find_repeated_misses
from pretouch_registrar.ray_casting import cast_rays, spread_extents

_TRUTHS, _TRUTHS_AFTER, _TRUTHS_OF_FEW = 12, 8, 24
"""Corrections drawn from the estimate: before the first scan, after it, and for few pieces, which deserve more: the
best of hundreds by eight truths is the one that these happen to favour."""
FEW_PIECES = 8
_SCALE = 0.4
"""Share of the Gauss-Newton information of the whole path, added to the present one, that gives the covariance over
which quadratics are fitted. It knows neither the edges nor where the cost saturates, so that less than all of it is
right."""
_PAIRS = 36
"""Antithetic pairs that a quadratic is fitted to: fewer than for a solution, as truths are averaged."""
_GOLDEN = 0.6180339887


class Density(NamedTuple):
    """How many beams are simulated for each truth: along a path at least, along its shortest piece, and at most."""

    least: int
    piece: int
    most: int

    def count_slots(self, candidate: Candidate) -> int:
        """The number of beams along the candidate's path."""
        shortest = min(end - start for start, end in candidate.pieces)
        wanted = self.piece * candidate.path.duration / max(shortest, 1e-9) if candidate.spans else 0.0
        return int(np.clip(np.ceil(wanted), self.least, self.most))


_THIN, _WIDE = Density(30, 6, 48), Density(12, 3, 24)
"""For thin beams, and for wide ones, whose spots overlap. The truths' beams lie between each other's."""


class Outcome(NamedTuple):
    """What a scan leaves: the estimate's covariance (6, 6), and the share of its samples that return."""

    covariance: Array
    returns: float


class _SimulatedBeams(NamedTuple):
    """Beams of t truths in n slots along a path: slots' times (n,), s; origins, m, and directions (t, n, 3)."""

    times: Array
    origins: Array
    directions: Array

    def choose(self, piece: tuple[float, float]) -> NDArray[np.bool_]:
        """(n,): the slots within a span of time, s; the one in its middle if there is none."""
        start, end = piece
        chosen = (self.times >= start) & (self.times <= end)
        chosen[np.abs(self.times - 0.5 * (start + end)).argmin()] = True
        return chosen


def count_truths(problem: RegistrationProblem, pieces: int) -> int:
    """The number of truths that are drawn to predict scans of so many pieces."""
    if pieces <= FEW_PIECES:
        return _TRUTHS_OF_FEW
    return _TRUTHS_AFTER if len(problem.beams.weights) else _TRUTHS


def predict_candidate(
    problem: RegistrationProblem,
    x: Array,
    covariance: Array,
    candidate: Candidate,
    sensor: Sensor,
    earlier: Patches,
    truths_drawn: int = _TRUTHS,
) -> list[Outcome]:
    """What a scan of each of the candidate's pieces would leave of the estimate x (6,) with `covariance` (6, 6).

    The mean over `truths_drawn` truths. Covariances are averaged, not information, so that the chance that a scan
    misses the object counts. Systematic errors remain, samples where earlier scans were add less information, and where
    those missed, so will this one.

    Args:
        earlier: the patches of the problem's beams.
    """
    draws = _draw_normal(truths_drawn)
    truths = np.concatenate([x[None], x + draws @ np.linalg.cholesky(covariance).T])
    simulated = assume_likeliest_hypothesis(x, problem).without_prior()
    beams = _sample_beams(candidate, sensor, (_WIDE if problem.wide else _THIN).count_slots(candidate), len(truths))
    extents = np.insert(spread_extents(len(draws))[_shuffle(len(draws))], 0, 0.0)
    ranges = cast_rays(simulated, truths, beams.origins, beams.directions, extents, sensor.range_min)
    returned = ranges <= sensor.range_max
    returned[:, find_repeated_misses(problem.beams, beams.origins[0], beams.directions[0])] = False
    ranges = np.where(returned, ranges, 0.0)
    points = beams.origins + ranges[..., None] * beams.directions
    grouping = group_samples(points[0], beams.directions[0], returned[0], problem.shared, earlier)
    rate = sensor.rate * len(sensor.tip_T_module)
    chosen = np.stack([beams.choose(piece) for piece in (*candidate.pieces, _whole(candidate))])
    durations = np.array([end - start for start, end in (*candidate.pieces, _whole(candidate))])
    weights = grouping.weigh(chosen, problem.shared, np.maximum(rate * durations / chosen.sum(axis=1), 1.0))
    weights /= np.array([problem.predict_temperature(float(each.sum())) for each in weights])[:, None]
    n = (len(draws) * len(beams.times), 3)
    seen = Beams(
        points[1:].reshape(n), beams.directions[1:].reshape(n), returned[1:].ravel(),
        np.tile(weights[-1], len(draws)), ranges[1:].ravel(),
    )  # fmt: skip
    precision = np.linalg.inv(_subtract_covariance(covariance, problem.systematic_covariance))
    normal, fit = make_curvature_draws(_PAIRS)
    mean = _average_covariances(
        truths[1:],
        simulated._replace(beams=seen, temperature=1.0),
        weights[:-1],
        np.asarray(precision, dtype=np.float64),
        normal,
        np.ascontiguousarray(fit[1:]),
    )
    return [
        Outcome(left + problem.systematic_covariance, float(returned[1:, slots].mean()))
        for left, slots in zip(mean, chosen, strict=False)
    ]


def _whole(candidate: Candidate) -> tuple[float, float]:
    return float(candidate.path.t[0]), float(candidate.path.t[-1])


def _sample_beams(candidate: Candidate, sensor: Sensor, slots: int, sets: int) -> _SimulatedBeams:
    """`sets` beams in each of `slots` equal parts of the path, of all modules in turn."""
    path = candidate.path
    width = path.duration / slots
    times = path.t[0] + (np.arange(slots) + 0.5) * width
    offsets = width * ((np.argsort(_shuffle(sets)) + 0.5) / sets - 0.5)
    at = np.clip(times + offsets[:, None], path.t[0], path.t[-1])
    modules = np.stack([pose.matrix for pose in sensor.tip_T_module])
    turn = np.arange(sets)[:, None] + np.arange(slots) * sets
    which = ((turn * _GOLDEN % 1.0) * len(modules)).astype(np.intp)
    base_T_module = path.at(at.ravel()).reshape(sets, slots, 4, 4) @ modules[which]
    return _SimulatedBeams(
        times, np.ascontiguousarray(base_T_module[..., :3, 3]), np.ascontiguousarray(base_T_module[..., :3, 2])
    )


@cache
def _shuffle(count: int) -> NDArray[np.intp]:
    """A permutation of `count` numbers without a trend."""
    return np.argsort(np.arange(count) * _GOLDEN % 1.0)


def _subtract_covariance(covariance: Array, systematic: Array) -> Array:
    """A covariance (6, 6) less its `systematic` part (6, 6); at least a tenth of it is left in each direction."""
    root = np.linalg.cholesky(covariance)
    whiten = np.linalg.inv(root)
    values, vectors = np.linalg.eigh(np.eye(6) - whiten @ systematic @ whiten.T)
    return np.asarray(root @ (vectors * np.maximum(values, 0.1)) @ vectors.T @ root.T, dtype=np.float64)


@cache
def _draw_normal(count: int) -> Array:
    """(count, 6) antithetic standard normal draws from a Sobol sequence; `count` is even, at most 32."""
    half = norm.ppf(0.001 + 0.998 * qmc.Sobol(6, seed=3).random(16))[: count // 2]
    return np.concatenate([half, -half])


@njit(cache=True, nogil=True)
def _average_covariances(
    truths: Array, problem: RegistrationProblem, weights: Array, precision: Array, draws: Array, fit: Array
) -> Array:
    """(p, 6, 6): for each piece, the mean over truths (t, 6) of the covariance after its beams.

    Args:
        problem: with the beams of all truths, equally many for each, in the order of the truths.
        weights: (p, n) of a truth's n beams in each piece.
        precision: (6, 6), before the scan.
        draws, fit: see `fit_quadratics`.
    """
    total = np.zeros((weights.shape[0], 6, 6))
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
        information, _, _ = linearize(truths[k], each)
        root = np.linalg.cholesky(np.linalg.inv(_SCALE * information + precision))
        coefficients = fit_quadratics(truths[k], each, root, draws, fit)
        for p in range(weights.shape[0]):
            total[p] += compiled_covariance_of_quadratic(weights[p] @ coefficients, root, precision)
    return total / truths.shape[0]
