"""Priors with any mean and covariance."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pretouch.geometry import Array, Pose
from pretouch.prior import PosePrior

_units = st.floats(-1, 1, allow_subnormal=False)


def covariance_of(stds: Array, turn: Array) -> Array:
    """The covariance (6, 6) with standard deviations (6,) along axes that are turned by the QR factor of (6, 6)."""
    axes = np.linalg.qr(turn + 2 * np.eye(6))[0]
    covariance = (axes * np.asarray(stds) ** 2) @ axes.T
    return np.asarray(0.5 * (covariance + covariance.T), dtype=np.float64)


covariances = st.builds(
    covariance_of,
    arrays(np.float64, 6, elements=st.floats(-4.5, -1)).map(lambda exponents: 10**exponents),
    arrays(np.float64, (6, 6), elements=_units),
)
"""Standard deviations of 0.03 mm to 10 cm, and as many rad, along any axes."""
means = st.builds(
    lambda turn, shift: Pose.from_rotation_vector(0.4 * turn, 0.2 * shift),
    arrays(np.float64, 3, elements=_units),
    arrays(np.float64, 3, elements=_units),
)
pose_priors = st.builds(PosePrior, means, covariances)
