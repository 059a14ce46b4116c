"""How much wider than its density says the posterior truly is: by what the engine can see of its own fit.

The logarithm of the factor by which standard deviations are widened is linear in a few figures of the answer. It was
fitted, with what no sample averages out (`problem`), by the log score of the truth, a Student t so that single failures
do not rule it: 700 answers after 1 to 5 scans on training meshes before simulated cameras `kinect` and `random` under
fingers `ideal`, `cone` and `random`, and on two real frames (0000_000001 and 0000_000003 of YCB-Video). The constant
was then raised from -0.28, the samples' share lowered from 0.10, and few samples made to count, by eye: after one scan
83 to 88 % of such truths lay in the 95 % region, and in the 50 % region a third after a fifth of a scan. The share of
contradicting samples of a thin beam was raised from 1.2 on 13 to 17 views of training meshes each, with and without
spots where the camera saw the table through the object: truths in the 95 % region after three scans 69 to 92 % with
such spots, 94 % without as before.
"""

from __future__ import annotations

import numpy as np

from pretouch.geometry import Array
from pretouch_registrar.engines.inliers import Judged
from pretouch_registrar.engines.problem import Problem

_CONSTANT, _WIDE = -0.15, 0.43
_CONTRADICTING, _CONTRADICTING_WIDE, _HIDDEN = 4.0, 1.2, 0.6
"""For the share of the samples that contradict the answer beyond the usual, of a thin and of a wide beam, and of the
returns that it leaves to what the camera did not see."""
_USUAL, _USUAL_WIDE = 0.03, 0.20
"""Shares of contradicting samples that a right answer leaves, of a thin and of a wide beam."""
_FAR, _FAR_FROM = 0.34, 1.5
"""For each standard deviation of the prior by which the largest component of the correction exceeds _FAR_FROM."""
_MANY, _SPARSE, _ENOUGH = 0.06, 0.08, 100.0
"""For the logarithm of the samples' worth over _ENOUGH, and, where it is less, for that of its inverse: few samples
leave many places, of which the search does not find all."""
_MOST = 1.5


def widening(x: Array, verdict: Judged, problem: Problem) -> float:
    """The factor for the standard deviations of the posterior at its mean x (6,), whose samples are `verdict`."""
    weights, hit = problem.beams.weights, problem.beams.returned
    total, returns = max(float(weights.sum()), 1e-9), max(float(weights[hit].sum()), 1e-9)
    contradicting = float(weights[verdict.contradict].sum()) / total
    hidden = float(weights[hit & ~verdict.agree & ~verdict.contradict].sum()) / returns
    usual = _USUAL_WIDE if problem.wide else _USUAL
    far = max(float(np.abs(x * np.sqrt(problem.prior)).max()) - _FAR_FROM, 0.0)
    logarithm = (
        _CONSTANT
        + _WIDE * problem.wide
        + (_CONTRADICTING_WIDE if problem.wide else _CONTRADICTING) * (contradicting - usual)
        + _HIDDEN * hidden
        + _FAR * far
        + max(_MANY * np.log(total / _ENOUGH), _SPARSE * np.log(_ENOUGH / total))
    )
    return float(np.exp(np.clip(logarithm, -_MOST, _MOST)))
