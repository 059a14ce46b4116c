"""Engine `posterior`: the posterior's mean and covariance given returns and misses, searched over the whole prior.

The density of a correction is exp(-energy), see `objective`. A population is annealed from widened noise to the true
one (`smc`), its best members are refined (`levenberg_marquardt`), and the moments of the density are estimated by
importance sampling around the distinct modes found (`laplace`, `importance`).
"""

from __future__ import annotations

import numpy as np

from pretouch.geometry import Array
from pretouch_registrar.engines.camera_model import CameraModel
from pretouch_registrar.engines.covariance_inflation import compute_inflation, inflate
from pretouch_registrar.engines.inliers import classify_samples
from pretouch_registrar.engines.laplace import compute_covariance
from pretouch_registrar.engines.objective import assume_likeliest_hypothesis, compute_energies_in_parallel
from pretouch_registrar.engines.registration_problem import RegistrationProblem
from pretouch_registrar.engines.resources import Resources
from pretouch_registrar.engines.solution import Solution
from pretouch_registrar.engines.solvers import importance, smc
from pretouch_registrar.engines.solvers.importance import Mode
from pretouch_registrar.engines.solvers.levenberg_marquardt import refine

_SEARCH_BEAMS = 120
_MAX_BEAMS = 320
"""Beams for the search, and for refinement and moments."""
_WIDE_BEAMS = (80, 160)
"""The same for a wide beam: its samples overlap, and each takes longer."""
_MAX_MERGED = 2
"""Multiple of the beams for refinement that are left when a thin beam's neighbours are merged: those of a few scans."""
_ROUGH_NOISE_FACTOR = 2.0
"""Noise factor above which half the beams suffice for the search."""
_STARTS = 10
"""Members of the last population that are refined, and their least distance, in standard deviations of the prior."""
_APART = 0.15
_MODES = 3
_BROAD_SHARE = 0.5
"""Weight of the mode fitted to the whole population, beside the refined modes, whose weights sum to 1."""
_MODES_APART = 0.25
_MAX_ENERGY_ABOVE_BEST = 6.0
"""A mode is kept if its energy exceeds the best one's by at most this."""
_MAX_ENERGY_NAMED = 3.0
"""A mode is part of the solution if its energy exceeds the best one's by at most this."""


def solve(problem: RegistrationProblem, model: CameraModel, resources: Resources) -> Solution:
    """The posterior's mean and covariance, and other modes that explain the samples nearly as well."""
    search, most = _WIDE_BEAMS if problem.wide else (_SEARCH_BEAMS, _MAX_BEAMS)
    distinct = problem.pool_beams() if problem.wide else problem.merge_neighbours(_MAX_MERGED * most)
    rough, coarse, fine = (distinct.subsample_beams(beams) for beams in (search // 2, search, most))
    prior = problem.prior

    def energy(xs: Array, among: RegistrationProblem = fine) -> Array:
        """Negative log posterior densities (m,) of corrections xs (m, 6)."""
        return compute_energies_in_parallel(xs, among, resources)

    xs, level = smc.sample_population(
        lambda xs, factor: energy(xs, (rough if factor > _ROUGH_NOISE_FACTOR else coarse).widen_noise(factor)), prior
    )
    starts = _select_distinct(xs[np.argsort(level, kind="stable")], prior.whiten / _APART, _STARTS)
    refined = np.array(resources.map(lambda x: refine(x, assume_likeliest_hypothesis(x, fine)), starts))
    level = energy(refined)
    order = np.argsort(level, kind="stable")
    order = order[level[order] < level.min() + _MAX_ENERGY_ABOVE_BEST]
    places = _select_distinct(refined[order], prior.whiten / _MODES_APART, _MODES)
    heights = energy(places)
    covariances = [compute_covariance(fine, place, resources) for place in places]
    found = _weigh_modes(places, covariances, heights)
    modes = [_whiten_mode(mode, prior.whiten) for mode in [*found, _fit_broad_mode(xs)]]
    mean, covariance = importance.estimate_moments(lambda z: energy(z @ prior.root.T), modes)
    mean, covariance = _remove_free_turn(prior.root @ mean, problem), prior.root @ covariance @ prior.root.T
    inflation = compute_inflation(mean, classify_samples(mean, problem), problem)
    covariance = inflate(covariance, inflation, prior) + problem.systematic_covariance
    likely = heights < level.min() + _MAX_ENERGY_NAMED
    shares = np.array([mode.share for mode in found])[likely]
    return Solution(mean, covariance, places[likely][1:], shares / shares.sum())


def _remove_free_turn(x: Array, problem: RegistrationProblem) -> Array:
    """The correction (6,) without its unobservable turn, in which the prior's mean is kept, given the rest."""
    free, precision = problem.free_turn, problem.prior.precision
    information = float(free @ precision @ free)
    if information == 0.0:
        return x
    return np.asarray(x - float(free @ precision @ x) / information * free, dtype=np.float64)


def _fit_broad_mode(xs: Array) -> Mode:
    """The whole population xs (m, 6) as one mode, so that the proposal also covers places between the refined modes."""
    return Mode(xs.mean(axis=0), np.asarray(np.cov(xs.T), dtype=np.float64), _BROAD_SHARE)


def _whiten_mode(mode: Mode, whiten: Array) -> Mode:
    """The mode in the coordinates of `whiten` (6, 6), in which the prior is round."""
    return Mode(whiten @ mode.mean, whiten @ mode.covariance @ whiten.T, mode.share)


def _select_distinct(xs: Array, whiten: Array, most: int) -> Array:
    """The first of xs (m, 6) that are more than 1 apart in the coordinates of `whiten` (6, 6), at most `most`."""
    chosen: list[Array] = []
    for x in xs:
        if all(np.linalg.norm(whiten @ (x - other)) > 1.0 for other in chosen):
            chosen.append(x)
            if len(chosen) == most:
                break
    return np.array(chosen)


def _weigh_modes(places: Array, covariances: list[Array], heights: Array) -> list[Mode]:
    """A mode at each of `places` (k, 6), its share by the Laplace approximation; `heights` (k,) are their energies."""
    log_share = np.array([0.5 * np.linalg.slogdet(covariance)[1] for covariance in covariances])
    log_share -= heights
    share = np.maximum(np.exp(log_share - log_share.max()), 0.05)
    share /= share.sum()
    return [Mode(*mode) for mode in zip(places, covariances, share.tolist(), strict=True)]
