"""How often a test can tell a knock at all from two sessions after it.

The mean of two sessions after the knock differs from that of those before by the knock, with the covariances of both
means together: each session's is the residual's and its own. If these are known, the likelihood ratio is chi-square of
d degrees of freedom, noncentral by the knock squared over that variance, and no test that treats all directions alike
does better. If the residual must be learned from the sessions before, it has an F distribution (as in the analysis of
variance, for equal axes: three degrees of freedom from each session before but one).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, f, ncf, ncx2

from experiments.camera_worlds import RESIDUAL_ROTATION, RESIDUAL_TRANSLATION

FALSE_ALARMS = 1 / 200
AFTER = 2


@dataclass(frozen=True)
class Bound:
    """Power for the residual known, and learned from the sessions before.

    Attributes:
        known, learned: by a test of the three axes of translation, or rotation, alone.
        known_6, learned_6: by a test of all six.
    """

    known: float
    learned: float
    known_6: float
    learned_6: float


def bound_shift(size: float, session_std: float, before: int) -> Bound:
    """A push of `size` m after `before` sessions that know their answers to `session_std` m along each axis."""
    return _bound(size, RESIDUAL_TRANSLATION, session_std, before)


def bound_turn(size: float, session_std: float, before: int) -> Bound:
    """A turn about the object of `size` rad, likewise."""
    return _bound(size, RESIDUAL_ROTATION, session_std, before)


def _bound(size: float, residual: float, session: float, before: int) -> Bound:
    shift = size**2 / ((residual**2 + session**2) * (1 / before + 1 / AFTER))
    freedom = 3 * (before - 1)
    powers = []
    for axes in (3, 6):
        known = ncx2.sf(chi2.isf(FALSE_ALARMS, axes), axes, shift)
        learned = ncf.sf(f.isf(FALSE_ALARMS, axes, freedom), axes, freedom, shift)
        powers += [float(known), float(learned)]
    return Bound(*np.round(powers, 4).tolist())
