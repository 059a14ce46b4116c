"""Global search over the prior by annealed sequential Monte Carlo."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from scipy.stats import norm, qmc

from pretouch.geometry import Array
from pretouch_registrar.engines.prior import CorrectionPrior

POPULATION = 300
_DRAWS = 2048
_BOUND = 1.75
"""Standard deviations of the prior: half the side of the box that the first draws cover evenly."""
_LEVELS = ((4.0, 1), (2.8, 1), (2.0, 1), (1.4, 2), (1.0, 4))
"""Noise factors, and the Metropolis steps at each."""
_STEP_LENGTHS = (0.3, 0.7, 1.0)

Energy = Callable[[Array, float], Array]
"""Of corrections (m, 6) and a noise factor: the negative log posterior densities (m,)."""


def sample_population(energy: Energy, prior: CorrectionPrior) -> tuple[Array, Array]:
    """Corrections (POPULATION, 6) distributed as the posterior, and their energies.

    At each noise factor the population is resampled by the increment of the likelihood, and then moved by
    differential-evolution Metropolis steps (ter Braak 2006), whose directions come from the population itself. The
    random numbers are fixed. The first population fills a box if the prior is flat, and is the prior's own if it is
    normal.
    """
    rng = np.random.default_rng(0)
    first = _draw_normal() if prior.normal else _draw_box()
    xs = first @ prior.root.T
    before = 0.5 * (first**2).sum(axis=1) if prior.normal else np.zeros(len(xs))
    for factor, moves in _LEVELS:
        level = energy(xs, factor)
        gain = before - level
        likelihood = np.exp(gain - gain.max())
        steps = (np.arange(POPULATION) + rng.uniform()) / POPULATION
        chosen = np.searchsorted(np.cumsum(likelihood) / likelihood.sum(), steps).clip(max=len(xs) - 1)
        xs, level = xs[chosen], level[chosen]
        for _ in range(moves):
            a, b = rng.integers(POPULATION, size=(2, POPULATION))
            length = rng.choice(_STEP_LENGTHS, size=(POPULATION, 1))
            jitter = 0.05 * rng.standard_normal(xs.shape) * factor / 4 @ prior.root.T
            proposed = xs + length * (xs[a] - xs[b]) + jitter
            new = energy(proposed, factor)
            accepted = np.log(rng.uniform(1e-300, 1, POPULATION)) < level - new
            xs[accepted], level[accepted] = proposed[accepted], new[accepted]
        before = level
    return xs, level


@cache
def _draw_normal() -> Array:
    """(_DRAWS, 6) standard normal draws from a Sobol sequence; the first one is no correction."""
    draws = np.asarray(norm.ppf(_draw_evenly()), dtype=np.float64)
    draws[0] = 0.0
    return draws


@cache
def _draw_box() -> Array:
    """(_DRAWS, 6) in standard deviations: a Sobol sequence over the prior's box; the first one is no correction."""
    draws = np.asarray((2 * _draw_evenly() - 1) * _BOUND, dtype=np.float64)
    draws[0] = 0.0
    return draws


def _draw_evenly() -> Array:
    """(_DRAWS, 6) in (0, 1)."""
    return np.asarray(np.clip(qmc.Sobol(6, seed=0).random(_DRAWS), 1e-6, 1 - 1e-6), dtype=np.float64)
