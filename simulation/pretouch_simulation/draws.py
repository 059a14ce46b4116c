"""Random numbers of distributions that numpy lacks."""

from __future__ import annotations

import numpy as np


def draw_log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A number from `low` to `high` whose logarithm is uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
