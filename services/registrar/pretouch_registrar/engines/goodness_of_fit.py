"""Tests whether a solution explains the samples: a posterior predictive check.

A share of the samples, counted by their weights, contradicts even a correct solution: outliers, and errors of the
models of camera and finger. That share varies with object and sensor, by a beta distribution, so that the number of
contradicting samples is beta-binomial. The p-value is the tail probability of the observed number.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.stats import betabinom

from pretouch_registrar.engines.inliers import Classification
from pretouch_registrar.engines.registration_problem import RegistrationProblem

_SHARE, _WIDE_SHARE = 0.04, 0.20
"""Mean share of samples that contradict correct solutions on training meshes, for thin and wide beams."""
_CONCENTRATION = 12.0
"""a + b of the beta distribution of that share."""


def compute_p_value(classification: Classification, problem: RegistrationProblem, scans: Sequence[int]) -> float:
    """The p-value, in [0, 1]: of all samples together, or of the worst scan, corrected for the number of tests.

    Args:
        scans: how many of the problem's beams belong to each scan, in the same order.
    """
    together = _tail_probability(classification, problem, slice(None))
    ends = np.cumsum([0, *scans])
    if len(scans) < 2:
        return together
    single = min(_tail_probability(classification, problem, slice(start, end)) for start, end in pairwise(ends))
    return min(1.0, 2.0 * min(together, len(scans) * single))


def _tail_probability(classification: Classification, problem: RegistrationProblem, part: slice) -> float:
    weights = problem.beams.weights[part]
    if not len(weights):
        return 1.0
    share = float(weights[classification.contradicting[part]].sum()) / max(float(weights.sum()), 1e-9)
    count = max(1, round(float(weights.sum()) / problem.temperature))
    expected = _WIDE_SHARE if problem.wide else _SHARE
    observed = round(share * count)
    return float(betabinom.sf(observed - 1, count, expected * _CONCENTRATION, (1.0 - expected) * _CONCENTRATION))
