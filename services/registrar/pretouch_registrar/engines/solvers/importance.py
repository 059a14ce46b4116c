"""Mean and covariance of a density with a few modes, by adaptive importance sampling.

Draws from a mixture of Student distributions, one a mode, are weighed by the density itself; the mixture is fitted to
them and drawn from again, until enough draws carry the weight. All draws count, under the mixture of all rounds
(Cornuet et al. 2012, AMIS). Where few carry it, the mixture is fitted to a power of the weights, so that proposals that
are too wide shrink step by step (El-Laham, Elvira and Bugallo, "Robust covariance adaptation in adaptive importance
sampling", 2018).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import lgamma

import numpy as np

from pretouch.geometry import Array

_DRAWS = 384
_LEAST_ROUNDS, _MOST_ROUNDS = 2, 5
_PLENTY = 100.0
"""Effective draws after which no further round is needed."""
_FITTED = 60.0
"""Effective draws that a mixture is fitted to, at least."""
_FREEDOM = 6.0
_INFLATED = 1.3
"""A proposal is this much wider than what it stands for, in variance."""
_LEAST_SHARE = 0.04
_ENOUGH = 25.0
"""Effective draws from which a mode is fitted anew."""
_BISECTIONS = 12
_ROUNDING = 1e-7
"""Variance that keeps a fitted covariance positive definite; the density's coordinates are of the order of 1."""
_DOUBT = 10.0
"""Effective draws at which their covariance counts half, the best mode's own the other half."""


@dataclass(frozen=True, eq=False)
class Mode:
    """A place of high density: mean (6,), covariance (6, 6), share of the whole."""

    mean: Array
    covariance: Array
    share: float


def moments(energy: Callable[[Array], Array], modes: list[Mode]) -> tuple[Array, Array]:
    """Mean (6,) and covariance (6, 6) of the density exp(-energy), energies (m,) of corrections (m, 6).

    Where few draws carry all the weight, the covariance leans on that of the largest mode.
    """
    rng = np.random.default_rng(1)
    total = sum(mode.share for mode in modes)
    modes = [Mode(mode.mean, mode.covariance, mode.share / total) for mode in modes]
    draws, energies, proposals = [], [], []
    for turn in range(1, _MOST_ROUNDS + 1):
        batch = np.concatenate([_student(rng, mode) for mode in modes])
        draws.append(batch)
        energies.append(energy(batch))
        proposals += modes
        xs = np.concatenate(draws)
        density = sum(mode.share * _student_density(xs, mode) for mode in proposals)
        log_weight = -np.concatenate(energies) - np.log(density + 1e-300)
        weight = _normalised(log_weight)
        if turn == _MOST_ROUNDS or (turn >= _LEAST_ROUNDS and _effective(weight) > _PLENTY):
            break
        modes = _fitted(modes, xs, _tempered(log_weight))
    mean = weight @ xs
    apart = xs - mean
    covariance = (weight[:, None] * apart).T @ apart
    effective = _effective(weight)
    trust = effective / (effective + _DOUBT)
    largest = max(modes, key=lambda mode: mode.share)
    return mean, trust * covariance + (1.0 - trust) * largest.covariance


def _normalised(log_weight: Array) -> Array:
    """(n,) weights that sum to 1."""
    weight = np.exp(log_weight - log_weight.max())
    return np.asarray(weight / weight.sum(), dtype=np.float64)


def _effective(weight: Array) -> float:
    """How many draws of equal weight tell as much."""
    return 1.0 / float((weight**2).sum())


def _tempered(log_weight: Array) -> Array:
    """(n,): the weights to the greatest power, at most 1, that leaves _FITTED effective draws; normalised."""
    low, high = 0.0, 1.0
    if _effective(_normalised(log_weight)) >= _FITTED:
        return _normalised(log_weight)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        if _effective(_normalised(middle * log_weight)) >= _FITTED:
            low = middle
        else:
            high = middle
    return _normalised(low * log_weight)


def _fitted(modes: list[Mode], xs: Array, weight: Array) -> list[Mode]:
    """The modes as the weighted draws nearest to each show them; those without weight are dropped."""
    distance = np.stack([_squared_distance(xs, mode.mean, mode.covariance) for mode in modes])
    owner = distance.argmin(axis=0)
    fitted = []
    for k, mode in enumerate(modes):
        own = weight * (owner == k)
        share = float(own.sum())
        if share < 1e-3:
            continue
        if share**2 / float((own**2).sum()) > _ENOUGH:
            mean = own @ xs / share
            apart = xs - mean
            covariance = (own[:, None] * apart).T @ apart / share + _ROUNDING * np.eye(6)
        else:
            mean, covariance = mode.mean, mode.covariance
        fitted.append(Mode(mean, covariance, max(share, _LEAST_SHARE)))
    total = sum(mode.share for mode in fitted)
    return [Mode(mode.mean, mode.covariance, mode.share / total) for mode in fitted]


def _student(rng: np.random.Generator, mode: Mode) -> Array:
    """Antithetic draws (n, 6), as many as the mode's share asks for."""
    half = max(int(mode.share * _DRAWS), 8) // 2
    normal = rng.standard_normal((half, 6))
    width = np.sqrt(rng.chisquare(_FREEDOM, (half, 1)) / _FREEDOM)
    steps = normal / width @ np.linalg.cholesky(_INFLATED * mode.covariance).T
    return np.asarray(mode.mean + np.concatenate([steps, -steps]), dtype=np.float64)


def _student_density(xs: Array, mode: Mode) -> Array:
    covariance = _INFLATED * mode.covariance
    log_scale = (
        lgamma((_FREEDOM + 6) / 2)
        - lgamma(_FREEDOM / 2)
        - 3 * np.log(_FREEDOM * np.pi)
        - 0.5 * float(np.linalg.slogdet(covariance)[1])
    )
    squared = _squared_distance(xs, mode.mean, covariance)
    return np.asarray(np.exp(log_scale - (_FREEDOM + 6) / 2 * np.log1p(squared / _FREEDOM)), dtype=np.float64)


def _squared_distance(xs: Array, mean: Array, covariance: Array) -> Array:
    """Mahalanobis distances (m,), squared."""
    apart = xs - mean
    return np.asarray((apart @ np.linalg.inv(covariance) * apart).sum(axis=1), dtype=np.float64)
