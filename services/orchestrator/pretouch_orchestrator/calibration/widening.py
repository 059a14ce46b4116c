"""How much wider than its normal distribution a prediction must be for its 95 % region to hold 95 %."""

from __future__ import annotations

from collections.abc import Sequence

from scipy.special import chdtri, fdtri

_AXES = 6
_BELIEF = 6.0
"""Degrees of freedom that the residual's covariance is known with before the first session."""
_PER_SESSION = 3.0
"""Degrees of freedom that a session adds to it: half of its directions, since sessions measure some of them badly."""
_WORTH = 3.0
"""Sessions that the belief in one's own predictions is worth."""
_MOST = 6.0
"""A session that surprises by more, which may be wrong, counts as this."""


def widen(surprises: Sequence[float]) -> float:
    """By what to multiply the covariance of a prediction, at least 1, after sessions that were predicted.

    Of a normal error whose covariance is itself estimated, with n degrees of freedom, the prediction is a multivariate
    t distribution: its squared norm over 6 has the distribution F(6, n). The normal prediction gets the same 95 %
    region. Where sessions surprised by more than was stated, on average, it is wider by that, too.

    Args:
        surprises: by session, the squared innovation by its expectation (`regimes.Course`).
    """
    freedom = _BELIEF + _PER_SESSION * (len(surprises) + 1)  # the first session, which nothing predicted, counts
    heavy = _AXES * fdtri(_AXES, freedom, 0.95) / chdtri(_AXES, 0.05)
    found = (_WORTH + sum(min(one, _MOST) for one in surprises)) / (_WORTH + len(surprises))
    return float(heavy * max(1.0, found))
