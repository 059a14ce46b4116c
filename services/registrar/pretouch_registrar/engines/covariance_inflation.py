"""Inflates the posterior's covariance for model errors, by features of the fit.

The logarithm of the factor on the standard deviations is linear in a few features of the solution. Together with the
systematic errors (`registration_problem`) it was fitted to the log score of the truth, under a Student t distribution
so that single failures do not dominate: 700 solutions after 1 to 5 scans on training meshes, with the simulated cameras
`kinect` and `random` and the fingers `ideal`, `cone` and `random`, and on two real frames (0000_000001 and 0000_000003
of YCB-Video). Then, by hand, the constant was raised from -0.28, the coefficient of the samples lowered from 0.10, and
one for few samples added: after one scan 83 to 88 % of such truths lay in the 95 % region, and after a fifth of a scan
a third of them in the 50 % region. The coefficient of contradicting samples of a thin beam was raised from 1.2 on 13 to
17 views of training meshes each, with and without holes where the camera saw the table through the object: after three
scans 69 to 92 % of the truths lay in the 95 % region with such holes, and 94 % without, as before.

All that was with the default prior, whose bounds the factor covers too. A stated prior is as wide as it says: where the
samples tell nothing, a factor below 1 must not make the answer surer than the prior was.
"""

from __future__ import annotations

import numpy as np

from pretouch.geometry import Array
from pretouch_registrar.engines.inliers import Classification
from pretouch_registrar.engines.prior import CorrectionPrior
from pretouch_registrar.engines.registration_problem import RegistrationProblem

_CONSTANT, _WIDE = -0.15, 0.43
_CONTRADICTING, _CONTRADICTING_WIDE, _HIDDEN = 4.0, 1.2, 0.6
"""Coefficients of the share of contradicting samples above the expected one, for a thin and a wide beam, and of the
share of returns that only a surface hidden from the camera explains."""
_EXPECTED, _EXPECTED_WIDE = 0.03, 0.20
"""Shares of samples that contradict even a correct solution, for a thin and a wide beam."""
_FAR = 0.34
"""Per standard deviation of the prior by which the correction is farther than usual."""
_MANY, _SPARSE, _ENOUGH = 0.06, 0.08, 100.0
"""Coefficients of the logarithm of the effective number of samples over _ENOUGH, and of its inverse if it is less: few
samples leave many modes, of which the search does not find all."""
_MAX_LOG_INFLATION = 1.5


def compute_inflation(x: Array, classification: Classification, problem: RegistrationProblem) -> float:
    """The factor on the posterior's standard deviations; `classification` is that of the samples at its mean x (6,)."""
    weights, hit = problem.beams.weights, problem.beams.returned
    total, returns = max(float(weights.sum()), 1e-9), max(float(weights[hit].sum()), 1e-9)
    contradicting = float(weights[classification.contradicting].sum()) / total
    hidden = float(weights[hit & ~classification.inlier & ~classification.contradicting].sum()) / returns
    expected = _EXPECTED_WIDE if problem.wide else _EXPECTED
    far = max(problem.prior.find_excess(x), 0.0)
    logarithm = (
        _CONSTANT
        + _WIDE * problem.wide
        + (_CONTRADICTING_WIDE if problem.wide else _CONTRADICTING) * (contradicting - expected)
        + _HIDDEN * hidden
        + _FAR * far
        + max(_MANY * np.log(total / _ENOUGH), _SPARSE * np.log(_ENOUGH / total))
    )
    return float(np.exp(np.clip(logarithm, -_MAX_LOG_INFLATION, _MAX_LOG_INFLATION)))


def inflate(covariance: Array, factor: float, prior: CorrectionPrior) -> Array:
    """The posterior's covariance (6, 6) with standard deviations larger by `factor`.

    Under a normal prior a factor below 1 acts on what the samples add to it: of a variance v relative to the prior's,
    which they alone know to v / (1 - v), v f^2 / (1 - v + v f^2) is left.
    """
    square = factor**2
    if not prior.normal:
        return square * covariance
    values, vectors = np.linalg.eigh(prior.whiten @ covariance @ prior.whiten.T)
    values = np.clip(values, 0.0, 1.0)
    inflated = square * values / np.minimum(1.0, 1.0 - values + square * values)
    return np.asarray(prior.root @ (vectors * inflated) @ vectors.T @ prior.root.T, dtype=np.float64)
