"""Engine `posterior`: hits and misses against everything the camera saw, searched over the whole prior.

The density of a correction is exp(-cost / temperature) times the prior, with the cost of `agreement`. A population
follows it from widened noise to the true one (`annealing`), its best members are refined (`local`), and the moments of
the density are taken by importance sampling around the distinct modes found (`importance`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pretouch.geometry import Array
from pretouch_registrar.engines import annealing, importance
from pretouch_registrar.engines.agreement import PRIOR_FLAT, PRIOR_SAG, PRIOR_WALL, spread_costs
from pretouch_registrar.engines.importance import Mode
from pretouch_registrar.engines.local import covariance_at, refine
from pretouch_registrar.engines.problem import EFFECTIVE_SAMPLES, Problem
from pretouch_registrar.engines.solution import Solution

_SEARCH_BEAMS = 120
_MAX_BEAMS = 320
"""Beams used to search, and to refine and take the moments."""
_WIDE_BEAMS = (80, 120)
"""The same for a wide beam: its samples overlap, and each costs more."""
_ROUGH = 2.0
"""Noise factor above which half the beams do for the search."""
_STARTS = 10
"""Members of the last population that are refined, and how far apart they are, in standard deviations of the prior."""
_APART = 0.15
_MODES = 3
_MODES_APART = 0.25
_MODE_GATE = 6.0
"""A mode is kept if its density is at least exp(-this) of the best one's."""
_NEARLY = 3.0
"""A mode is named in the answer if its density is at least exp(-this) of the best one's."""

_SYSTEMATIC, _WIDE_SYSTEMATIC = 0.0004, 0.0012
"""m: what no number of samples averages out, such as a sensor's bias and the camera's."""


def temperature(beams: Array) -> float:
    """What the cost of `Problem.beams` is divided by to be honest: samples share the model's error, the more the more
    there are. Chosen on training meshes for the best logarithmic score of the truth."""
    return float(0.6 * max(beams[:, 7].sum() / EFFECTIVE_SAMPLES, 1.0) ** 0.45)


def solve(problem: Problem) -> Solution:
    """The posterior's mean and covariance, and other modes that agree nearly as well."""
    search, most = _WIDE_BEAMS if len(problem.rays) else (_SEARCH_BEAMS, _MAX_BEAMS)
    coarse, fine = _thinned(problem, search), _thinned(problem, most)
    cold = temperature(problem.beams)
    scale = 1.0 / np.sqrt(problem.prior)
    rough = _thinned(problem, search // 2)
    xs, level = annealing.population(
        lambda x, factor: energy(x, factor, rough if factor > _ROUGH else coarse, cold), scale
    )
    starts = _distinct(xs[np.argsort(level, kind="stable")], _APART * scale, _STARTS)
    refined = np.array([refine(x, 1.0, problem.prior, *fine.arguments()) for x in starts])
    level = energy(refined, 1.0, fine, cold)
    order = np.argsort(level, kind="stable")
    order = order[level[order] < level.min() + _MODE_GATE]
    places = _distinct(refined[order], _MODES_APART * scale, _MODES)
    modes = [_in_units(mode, scale) for mode in _modes(fine, places, cold)]
    mean, covariance = importance.moments(lambda x: energy(x * scale, 1.0, fine, cold), modes)
    mean, covariance = mean * scale, covariance * np.outer(scale, scale)
    likely = energy(places, 1.0, fine, cold) < level.min() + _NEARLY
    systematic = _WIDE_SYSTEMATIC if len(problem.rays) else _SYSTEMATIC
    covariance[3:, 3:] += np.diag(np.minimum(systematic, scale[3:] / 10) ** 2)
    return Solution(mean, covariance, places[likely][1:])


def energy(xs: Array, factor: float, problem: Problem, cold: float) -> Array:
    """Negative logarithms (m,) of the posterior density of corrections xs (m, 6), at noise widened by `factor`."""
    sigmas = np.abs(xs) * np.sqrt(problem.prior)
    beyond = np.maximum(sigmas - PRIOR_FLAT, 0.0) / PRIOR_WALL
    prior = 0.5 * (PRIOR_SAG * sigmas**2 + beyond**2).sum(axis=1)
    return np.asarray(spread_costs(xs, factor, problem) / cold + prior, dtype=np.float64)


def _in_units(mode: Mode, scale: Array) -> Mode:
    """The mode in units of `scale` (6,), the prior's, so that nothing depends on how wide that is."""
    return Mode(mode.mean / scale, mode.covariance / np.outer(scale, scale), mode.share)


def _thinned(problem: Problem, most: int) -> Problem:
    step = max(1, -(-len(problem.beams) // most))
    beams = problem.beams[::step].copy()
    beams[:, 7] *= step
    return replace(problem, beams=beams)


def _distinct(xs: Array, apart: Array, most: int) -> Array:
    """The first of xs (m, 6) that differ by more than 1 in units of `apart` (6,), at most `most`."""
    chosen: list[Array] = []
    for x in xs:
        if all(np.linalg.norm((x - other) / apart) > 1.0 for other in chosen):
            chosen.append(x)
            if len(chosen) == most:
                break
    return np.array(chosen)


def _modes(problem: Problem, places: Array, cold: float) -> list[Mode]:
    """A mode at each of `places` (k, 6), its share by Laplace's formula."""
    covariances = [covariance_at(problem, place, cold) for place in places]
    log_share = np.array([0.5 * np.linalg.slogdet(covariance)[1] for covariance in covariances])
    log_share -= energy(places, 1.0, problem, cold)
    share = np.maximum(np.exp(log_share - log_share.max()), 0.05)
    share /= share.sum()
    return [Mode(*mode) for mode in zip(places, covariances, share.tolist(), strict=True)]
