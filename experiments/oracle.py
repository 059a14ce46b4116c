"""How much of the possible gain a proposer takes: random rectangles at one end, the best candidates at the other.

What is best by simulated scans is best by luck too. So the oracle chooses by one half of the hidden offsets and is
judged by the other half, and the other way round; choosing and judging by the same ones would promise too much.
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
    """m: mean error of the `best` candidates of (c, o), chosen by every other offset and judged by the rest, both ways.

    NaN if there are fewer than two offsets: nothing is left to judge by.
    """
    every = np.asarray(errors, dtype=np.float64)
    halves = every[:, ::2], every[:, 1::2]
    if every.shape[1] < 2:
        return math.nan
    return float(np.mean([_chosen(by, judged, best) for by, judged in (halves, halves[::-1])]))


def hindsight(errors: ArrayLike, best: int = BEST) -> float:
    """m: as `oracle`, chosen and judged by the same offsets: better than any chooser can hope to be."""
    every = np.asarray(errors, dtype=np.float64)
    return _chosen(every, every, best)


def ranked(errors: ArrayLike, by: ArrayLike, best: int = BEST) -> float:
    """m: mean error of the `best` candidates of (c, o) in the order of `by` (c,), the least first."""
    chosen = np.argsort(np.asarray(by), kind="stable")[:best]
    return float(np.asarray(errors, dtype=np.float64)[chosen].mean())


def gap_closed(random: float, achieved: float, best: float) -> float:
    """The share of the way from `random` to `best` that `achieved` goes; NaN where there is no way to go."""
    return (random - achieved) / (random - best) if random > best else math.nan


def _chosen(by: Array, judged: Array, best: int) -> float:
    return ranked(judged, by.mean(axis=1), best)
