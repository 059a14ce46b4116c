"""The share of the possible gain that a proposer achieves, between random rectangles and the best candidates.

Candidates that are best in simulated scans are so partly by chance. So the oracle chooses by one half of the hidden
offsets and is scored on the other half, and vice versa; choosing and scoring on the same ones would be too optimistic.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from pretouch.geometry import Array

BEST = 10


def chance(errors: ArrayLike) -> float:
    """m: mean error of all candidates (c, o) over all offsets."""
    return float(np.mean(np.asarray(errors, dtype=np.float64)))


def oracle(errors: ArrayLike, best: int = BEST) -> float:
    """m: mean error of the `best` candidates of (c, o), chosen by every other offset and scored on the rest, both ways.

    NaN if there are fewer than two offsets: nothing is left to score on.
    """
    every = np.asarray(errors, dtype=np.float64)
    halves = every[:, ::2], every[:, 1::2]
    if every.shape[1] < 2:
        return math.nan
    return float(np.mean([_chosen(by, held_out, best) for by, held_out in (halves, halves[::-1])]))


def hindsight(errors: ArrayLike, best: int = BEST) -> float:
    """m: as `oracle`, chosen and scored on the same offsets, an upper bound for any choice."""
    every = np.asarray(errors, dtype=np.float64)
    return _chosen(every, every, best)


def average_best(errors: ArrayLike, by: ArrayLike, best: int = BEST) -> float:
    """m: mean error of the `best` candidates of (c, o) in the order of `by` (c,), the least first."""
    chosen = np.argsort(np.asarray(by), kind="stable")[:best]
    return float(np.asarray(errors, dtype=np.float64)[chosen].mean())


def compute_gap_closed(random: float, achieved: float, best: float) -> float:
    """The share of the way from `random` to `best` that `achieved` goes; NaN if `best` is no better than `random`."""
    return (random - achieved) / (random - best) if random > best else math.nan


def _chosen(by: Array, held_out: Array, best: int) -> float:
    return average_best(held_out, by.mean(axis=1), best)
