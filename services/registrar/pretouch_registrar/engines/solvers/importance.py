"""Mean and covariance of a density with a few modes, by adaptive importance sampling.

Draws from a mixture of Student t distributions, one for each mode, are weighted by the density, and the mixture is
fitted to them, until the effective sample size suffices. All draws are used, under the mixture of all rounds (Cornuet
et al. 2012, AMIS). If the effective sample size is small, the mixture is fitted to a power of the weights, so that a
proposal that is too wide shrinks step by step (El-Laham, Elvira and Bugallo, "Robust covariance adaptation in adaptive
importance sampling", 2018).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import lgamma

import numpy as np

from pretouch.geometry import Array

_DRAWS = 384
_LEAST_ROUNDS, _MOST_ROUNDS = 2, 5
_SUFFICIENT_ESS = 100.0
"""Effective sample size at which no further round is needed."""
_MIN_MIXTURE_ESS = 60.0
"""Least effective sample size that a mixture is fitted to."""
_DEGREES_OF_FREEDOM = 6.0
_INFLATION = 1.3
"""Ratio of a proposal's variance to its mode's."""
_LEAST_SHARE = 0.04
_MIN_MODE_ESS = 25.0
"""Effective sample size above which a mode is fitted again."""
_BISECTIONS = 12
_REGULARISATION = 1e-7
"""Variance that keeps a fitted covariance positive definite; coordinates are of the order of 1."""
_HALF_TRUST_ESS = 10.0
"""Effective sample size at which the draws' covariance and the largest mode's have equal weight."""


@dataclass(frozen=True, eq=False)
class Mode:
    """A mode of the density: mean (6,), covariance (6, 6), share of the probability."""

    mean: Array
    covariance: Array
    share: float


def estimate_moments(energy: Callable[[Array], Array], modes: list[Mode]) -> tuple[Array, Array]:
    """Mean (6,) and covariance (6, 6) of the density exp(-energy), energies (m,) of corrections (m, 6).

    If the effective sample size is small, the covariance is mixed with that of the largest mode.
    """
    rng = np.random.default_rng(1)
    total = sum(mode.share for mode in modes)
    modes = [Mode(mode.mean, mode.covariance, mode.share / total) for mode in modes]
    draws, energies, proposals = [], [], []
    for turn in range(1, _MOST_ROUNDS + 1):
        batch = np.concatenate([_draw_student(rng, mode) for mode in modes])
        draws.append(batch)
        energies.append(energy(batch))
        proposals += modes
        xs = np.concatenate(draws)
        density = sum(mode.share * _student_density(xs, mode) for mode in proposals)
        log_weight = -np.concatenate(energies) - np.log(density + 1e-300)
        weight = _normalise(log_weight)
        if turn == _MOST_ROUNDS or (turn >= _LEAST_ROUNDS and _effective_sample_size(weight) > _SUFFICIENT_ESS):
            break
        modes = _refit(modes, xs, _temper(log_weight))
    mean = weight @ xs
    apart = xs - mean
    covariance = (weight[:, None] * apart).T @ apart
    effective = _effective_sample_size(weight)
    trust = effective / (effective + _HALF_TRUST_ESS)
    largest = max(modes, key=lambda mode: mode.share)
    return mean, trust * covariance + (1.0 - trust) * largest.covariance


def _normalise(log_weight: Array) -> Array:
    """(n,) weights that sum to 1."""
    weight = np.exp(log_weight - log_weight.max())
    return np.asarray(weight / weight.sum(), dtype=np.float64)


def _effective_sample_size(weight: Array) -> float:
    """Kish's effective sample size."""
    return 1.0 / float((weight**2).sum())


def _temper(log_weight: Array) -> Array:
    """(n,): the weights to the largest power, at most 1, with effective sample size _MIN_MIXTURE_ESS; normalised."""
    low, high = 0.0, 1.0
    if _effective_sample_size(_normalise(log_weight)) >= _MIN_MIXTURE_ESS:
        return _normalise(log_weight)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        if _effective_sample_size(_normalise(middle * log_weight)) >= _MIN_MIXTURE_ESS:
            low = middle
        else:
            high = middle
    return _normalise(low * log_weight)


def _refit(modes: list[Mode], xs: Array, weight: Array) -> list[Mode]:
    """The modes fitted to the weighted draws that are nearest to each; those without weight are dropped."""
    distance = np.stack([_squared_distance(xs, mode.mean, mode.covariance) for mode in modes])
    owner = distance.argmin(axis=0)
    fitted = []
    for k, mode in enumerate(modes):
        own = weight * (owner == k)
        share = float(own.sum())
        if share < 1e-3:
            continue
        if share**2 / float((own**2).sum()) > _MIN_MODE_ESS:
            mean = own @ xs / share
            apart = xs - mean
            covariance = (own[:, None] * apart).T @ apart / share + _REGULARISATION * np.eye(6)
        else:
            mean, covariance = mode.mean, mode.covariance
        fitted.append(Mode(mean, covariance, max(share, _LEAST_SHARE)))
    total = sum(mode.share for mode in fitted)
    return [Mode(mode.mean, mode.covariance, mode.share / total) for mode in fitted]


def _draw_student(rng: np.random.Generator, mode: Mode) -> Array:
    """Antithetic draws (n, 6), in proportion to the mode's share."""
    half = max(int(mode.share * _DRAWS), 8) // 2
    normal = rng.standard_normal((half, 6))
    width = np.sqrt(rng.chisquare(_DEGREES_OF_FREEDOM, (half, 1)) / _DEGREES_OF_FREEDOM)
    steps = normal / width @ np.linalg.cholesky(_INFLATION * mode.covariance).T
    return np.asarray(mode.mean + np.concatenate([steps, -steps]), dtype=np.float64)


def _student_density(xs: Array, mode: Mode) -> Array:
    covariance = _INFLATION * mode.covariance
    log_scale = (
        lgamma((_DEGREES_OF_FREEDOM + 6) / 2)
        - lgamma(_DEGREES_OF_FREEDOM / 2)
        - 3 * np.log(_DEGREES_OF_FREEDOM * np.pi)
        - 0.5 * float(np.linalg.slogdet(covariance)[1])
    )
    squared = _squared_distance(xs, mode.mean, covariance)
    return np.asarray(
        np.exp(log_scale - (_DEGREES_OF_FREEDOM + 6) / 2 * np.log1p(squared / _DEGREES_OF_FREEDOM)), dtype=np.float64
    )


def _squared_distance(xs: Array, mean: Array, covariance: Array) -> Array:
    """Mahalanobis distances (m,), squared."""
    apart = xs - mean
    return np.asarray((apart @ np.linalg.inv(covariance) * apart).sum(axis=1), dtype=np.float64)
