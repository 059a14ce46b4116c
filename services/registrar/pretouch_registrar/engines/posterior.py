"""Engine `posterior`: hits and misses against everything the camera saw, searched over the whole prior.

The density of a correction is exp(-energy), see `objective`. A population
follows it from widened noise to the true one (`smc`), its best members are refined (`levenberg_marquardt`), and the
moments of the density are taken by importance sampling around the distinct modes found (`laplace`, `importance`).
"""

from __future__ import annotations

import numpy as np

from pretouch.geometry import Array
from pretouch_registrar.engines.calibration import widening
from pretouch_registrar.engines.camera_model import CameraModel
from pretouch_registrar.engines.inliers import judged
from pretouch_registrar.engines.laplace import covariance_at
from pretouch_registrar.engines.objective import spread_energies, supposing_likeliest
from pretouch_registrar.engines.problem import Problem
from pretouch_registrar.engines.resources import Resources
from pretouch_registrar.engines.solution import Solution
from pretouch_registrar.engines.solvers import importance, smc
from pretouch_registrar.engines.solvers.importance import Mode
from pretouch_registrar.engines.solvers.levenberg_marquardt import refine

_SEARCH_BEAMS = 120
_MAX_BEAMS = 320
"""Beams used to search, and to refine and take the moments."""
_WIDE_BEAMS = (80, 160)
"""The same for a wide beam: its samples overlap, and each costs more."""
_ROUGH = 2.0
"""Noise factor above which half the beams do for the search."""
_STARTS = 10
"""Members of the last population that are refined, and how far apart they are, in standard deviations of the prior."""
_APART = 0.15
_MODES = 3
_BROAD_SHARE = 0.5
"""Weight of the population's spread beside the refined modes, whose weights sum to 1."""
_MODES_APART = 0.25
_MODE_GATE = 6.0
"""A mode is kept if its density is at least exp(-this) of the best one's."""
_NEARLY = 3.0
"""A mode is named in the answer if its density is at least exp(-this) of the best one's."""


def solve(problem: Problem, model: CameraModel, resources: Resources) -> Solution:
    """The posterior's mean and covariance, and other modes that agree nearly as well."""
    search, most = _WIDE_BEAMS if problem.wide else (_SEARCH_BEAMS, _MAX_BEAMS)
    distinct = problem.pooled() if problem.wide else problem
    rough, coarse, fine = (distinct.thinned(beams) for beams in (search // 2, search, most))
    scale = 1.0 / np.sqrt(problem.prior)

    def energy(xs: Array, among: Problem = fine) -> Array:
        """Negative logarithms (m,) of the posterior density of corrections xs (m, 6)."""
        return spread_energies(xs, among, resources)

    xs, level = smc.population(
        lambda xs, factor: energy(xs, (rough if factor > _ROUGH else coarse).widened(factor)), scale
    )
    starts = _distinct(xs[np.argsort(level, kind="stable")], _APART * scale, _STARTS)
    refined = np.array(resources.map(lambda x: refine(x, supposing_likeliest(x, fine)), starts))
    level = energy(refined)
    order = np.argsort(level, kind="stable")
    order = order[level[order] < level.min() + _MODE_GATE]
    places = _distinct(refined[order], _MODES_APART * scale, _MODES)
    heights = energy(places)
    covariances = [covariance_at(fine, place, resources) for place in places]
    found = _modes(places, covariances, heights)
    modes = [_in_units(mode, scale) for mode in [*found, _broad(xs)]]
    mean, covariance = importance.moments(lambda x: energy(x * scale), modes)
    mean, covariance = _unturned(mean * scale, problem), covariance * np.outer(scale, scale)
    covariance = widening(mean, judged(mean, problem), problem) ** 2 * covariance + problem.systematic
    likely = heights < level.min() + _NEARLY
    shares = np.array([mode.share for mode in found])[likely]
    return Solution(mean, covariance, places[likely][1:], shares / shares.sum())


def _unturned(x: Array, problem: Problem) -> Array:
    """The correction (6,) less what it turns about an axis that nothing tells of: where the prior would have it."""
    free = problem.free_turn
    information = float(free @ (problem.prior * free))
    if information == 0.0:
        return x
    return np.asarray(x - float(free @ (problem.prior * x)) / information * free, dtype=np.float64)


def _broad(xs: Array) -> Mode:
    """The whole population xs (m, 6) as one mode, so that no place between and beside the refined ones is left out."""
    return Mode(xs.mean(axis=0), np.asarray(np.cov(xs.T), dtype=np.float64), _BROAD_SHARE)


def _in_units(mode: Mode, scale: Array) -> Mode:
    """The mode in units of `scale` (6,), the prior's, so that nothing depends on how wide that is."""
    return Mode(mode.mean / scale, mode.covariance / np.outer(scale, scale), mode.share)


def _distinct(xs: Array, apart: Array, most: int) -> Array:
    """The first of xs (m, 6) that differ by more than 1 in units of `apart` (6,), at most `most`."""
    chosen: list[Array] = []
    for x in xs:
        if all(np.linalg.norm((x - other) / apart) > 1.0 for other in chosen):
            chosen.append(x)
            if len(chosen) == most:
                break
    return np.array(chosen)


def _modes(places: Array, covariances: list[Array], heights: Array) -> list[Mode]:
    """A mode at each of `places` (k, 6), its share by Laplace's formula; `heights` (k,) are the energies there."""
    log_share = np.array([0.5 * np.linalg.slogdet(covariance)[1] for covariance in covariances])
    log_share -= heights
    share = np.maximum(np.exp(log_share - log_share.max()), 0.05)
    share /= share.sum()
    return [Mode(*mode) for mode in zip(places, covariances, share.tolist(), strict=True)]
