"""A search that cannot be trapped within the prior: a population follows the density as the noise narrows."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from scipy.stats import qmc

from pretouch.geometry import Array

POPULATION = 300
_DRAWS = 2048
_BOUND = 1.75
"""Standard deviations of the prior between which the first draws lie, evenly."""
_LEVELS = ((4.0, 1), (2.8, 1), (2.0, 1), (1.4, 2), (1.0, 4))
"""Noise factor and Metropolis steps at it."""
_MOVES = (0.3, 0.7, 1.0)

Energy = Callable[[Array, float], Array]
"""Corrections (m, 6) and a noise factor to the negative logarithms (m,) of their posterior density."""


def population(energy: Energy, scale: Array) -> tuple[Array, Array]:
    """Corrections (POPULATION, 6) spread as the posterior, and their energies; `scale` (6,) is the prior's.

    Annealed sequential Monte Carlo: resampled at each noise factor by what that adds to the likelihood, then moved by
    differential-evolution Metropolis steps (ter Braak 2006), which take their directions from the population itself.
    The draws are fixed.
    """
    rng = np.random.default_rng(0)
    xs = _first_draws() * scale
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
            length = rng.choice(_MOVES, size=(POPULATION, 1))
            jitter = 0.05 * rng.standard_normal(xs.shape) * factor / 4 * scale
            proposed = xs + length * (xs[a] - xs[b]) + jitter
            new = energy(proposed, factor)
            accepted = np.log(rng.uniform(1e-300, 1, POPULATION)) < level - new
            xs[accepted], level[accepted] = proposed[accepted], new[accepted]
        before = level
    return xs, level


@cache
def _first_draws() -> Array:
    """(_DRAWS, 6) in standard deviations, evenly over the prior's box, with the uncorrected pose among them."""
    draws = np.asarray((2 * qmc.Sobol(6, seed=0).random(_DRAWS) - 1) * _BOUND, dtype=np.float64)
    draws[0] = 0.0
    return draws
