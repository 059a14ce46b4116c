"""Global search over the prior by annealed sequential Monte Carlo."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from scipy.stats import qmc

from pretouch.geometry import Array

POPULATION = 300
_DRAWS = 2048
_BOUND = 1.75
"""Standard deviations of the prior: half the side of the box that the first draws cover evenly."""
_LEVELS = ((4.0, 1), (2.8, 1), (2.0, 1), (1.4, 2), (1.0, 4))
"""Noise factors, and the Metropolis steps at each."""
_STEP_LENGTHS = (0.3, 0.7, 1.0)

Energy = Callable[[Array, float], Array]
"""Of corrections (m, 6) and a noise factor: the negative log posterior densities (m,)."""


def sample_population(energy: Energy, scale: Array) -> tuple[Array, Array]:
    """Corrections (POPULATION, 6) distributed as the posterior, and their energies.

    At each noise factor the population is resampled by the increment of the likelihood, and then moved by
    differential-evolution Metropolis steps (ter Braak 2006), whose directions come from the population itself. The
    random numbers are fixed.

    Args:
        scale: (6,), the prior's standard deviations.
    """
    rng = np.random.default_rng(0)
    xs = _draw_first() * scale
    before = np.zeros(len(xs))
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
            jitter = 0.05 * rng.standard_normal(xs.shape) * factor / 4 * scale
            proposed = xs + length * (xs[a] - xs[b]) + jitter
            new = energy(proposed, factor)
            accepted = np.log(rng.uniform(1e-300, 1, POPULATION)) < level - new
            xs[accepted], level[accepted] = proposed[accepted], new[accepted]
        before = level
    return xs, level


@cache
def _draw_first() -> Array:
    """(_DRAWS, 6) in standard deviations: a Sobol sequence over the prior's box; the first one is no correction."""
    draws = np.asarray((2 * qmc.Sobol(6, seed=0).random(_DRAWS) - 1) * _BOUND, dtype=np.float64)
    draws[0] = 0.0
    return draws
