"""Whether an answer explains the samples: a posterior predictive check.

Of the samples, counted by their worth, some share contradicts even a right answer: outliers, and what the models of
camera and finger get wrong. That share differs from world to world, here by a beta distribution, so that the number of
contradictions is beta-binomial. Its tail beyond what is observed is the p-value.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.stats import betabinom

from pretouch_registrar.engines.inliers import Judged
from pretouch_registrar.engines.problem import Problem

_SHARE, _WIDE_SHARE = 0.04, 0.20
"""Mean share of contradicting samples under right answers, thin and wide beams, on training meshes."""
_WORLDS = 12.0
"""How alike that share is in different worlds: a and b of the beta distribution sum to this."""


def p_value(verdict: Judged, problem: Problem, scans: Sequence[int]) -> float:
    """In [0, 1]: of all samples together and of each scan, whichever fits worst, corrected for their number.

    Args:
        scans: how many of the problem's beams belong to each scan, in their order.
    """
    together = _tail(verdict, problem, slice(None))
    ends = np.cumsum([0, *scans])
    if len(scans) < 2:
        return together
    single = min(_tail(verdict, problem, slice(start, end)) for start, end in pairwise(ends))
    return min(1.0, 2.0 * min(together, len(scans) * single))


def _tail(verdict: Judged, problem: Problem, part: slice) -> float:
    weights = problem.beams.weights[part]
    if not len(weights):
        return 1.0
    share = float(weights[verdict.contradict[part]].sum()) / max(float(weights.sum()), 1e-9)
    count = max(1, round(float(weights.sum()) / problem.temperature))
    expected = _WIDE_SHARE if problem.wide else _SHARE
    observed = round(share * count)
    return float(betabinom.sf(observed - 1, count, expected * _WORLDS, (1.0 - expected) * _WORLDS))
