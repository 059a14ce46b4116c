"""How much wider than its normal distribution a prediction must be for its 95 % region to hold 95 %."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import brentq
from scipy.special import betaln, chdtri, fdtr

from pretouch.geometry import Array

_AXES = 6
_FREEDOMS, _LOG_SCALES = (
    grid.ravel() for grid in np.meshgrid([4.0, 6.0, 9.0, 14.0, 25.0, 60.0], np.linspace(-0.35, 1.6, 12), indexing="ij")
)
_SCALES = np.exp(_LOG_SCALES)
_LOG_PRIOR: Array = np.log(np.repeat([0.4, 0.25, 0.15, 0.1, 0.06, 0.04], 12)) - 0.5 * ((_LOG_SCALES + 0.35) / 0.4) ** 2
"""Degrees of freedom and scales of cameras: chosen on two recordings of real pose pairs and on simulated campaigns."""
_LEAST, _MOST = 1e-3, 20.0
"""A session that surprises by more, which may be wrong, counts as this."""


def widen(surprises: Sequence[float]) -> float:
    """By what to multiply the covariance of a prediction, at least 1, after sessions that were predicted.

    Real cameras err with heavier tails than normal distributions, each in its own way. So the error of a prediction is
    taken for a multivariate t: its squared norm by its expectation has the distribution F(6, n), scaled. What n and the
    scale may be is told by the sessions, and by what cameras are like; the normal prediction gets the 95 % region of
    the mixture.

    Args:
        surprises: by session, the squared innovation by its expectation (`regimes.Course`).
    """
    weights = _LOG_PRIOR.copy()
    for surprise in np.clip(surprises, _LEAST, _MOST):
        weights += _log_density(surprise / _SCALES) - _LOG_SCALES
    shares = np.exp(weights - weights.max())
    shares /= shares.sum()
    found = brentq(lambda norm: float(shares @ fdtr(_AXES, _FREEDOMS, norm / _SCALES)) - 0.95, 1e-3, 1e3)
    return max(1.0, float(found * _AXES / chdtri(_AXES, 0.05)))


def _log_density(x: Array) -> Array:
    """Of the distribution F(6, n) for each n of the grid."""
    a, b = 0.5 * _AXES, 0.5 * _FREEDOMS
    density = a * np.log(a / b) + (a - 1) * np.log(x) - (a + b) * np.log1p(a / b * x) - betaln(a, b)
    return np.asarray(density, dtype=np.float64)
