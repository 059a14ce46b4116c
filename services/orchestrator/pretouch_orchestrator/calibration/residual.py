"""What differs from session to session, by direction: its covariance in the camera's axes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pretouch.geometry import Array
from pretouch_orchestrator.calibration.regimes import Reading

_WORTH = 7.0
"""Sessions that the belief in equal variances along all axes is worth: one more than there are directions."""
_ROUNDS = 5


def estimate_residual(readings: Sequence[Reading], covariance: Array, first: Array) -> Array:
    """The covariance (6, 6) of the residuals about the objects' centroids in the camera's axes, order as in `Estimate`.

    Expectation maximisation with an inverse Wishart prior about `first`. Directions that a session did not measure
    count as expected.

    Args:
        readings: of the sessions that count, linear around the estimated errors of both sides.
        covariance: (12, 12), of these errors.
        first: (6, 6), what is believed of the residuals before their shape is looked at.
    """
    prepared = [_prepare(reading, covariance) for reading in readings]
    found = first
    for _ in range(_ROUNDS):
        total = _WORTH * first
        for rows, values, noise, unknown in prepared:
            gain = found @ rows.T @ np.linalg.inv(rows @ found @ rows.T + noise)
            mean = gain @ values
            total = total + np.outer(mean, mean) + found - gain @ rows @ found + gain @ unknown @ gain.T
        found = total / (_WORTH + len(prepared))
    return np.asarray(0.5 * (found + found.T), dtype=np.float64)


def in_base(residual: Array, rotation: Array) -> Array:
    """The covariance (6, 6) in the axes to which `rotation` (3, 3) turns the camera's."""
    turns = _turns(rotation)
    return np.asarray(turns @ residual @ turns.T, dtype=np.float64)


def _prepare(reading: Reading, covariance: Array) -> tuple[Array, Array, Array, Array]:
    unknown = reading.jacobian @ covariance @ reading.jacobian.T
    return reading.rows @ _turns(reading.base_T_camera.rotation), reading.values, np.diag(reading.variances), unknown


def _turns(rotation: Array) -> Array:
    turns = np.zeros((6, 6))
    turns[:3, :3] = turns[3:, 3:] = rotation
    return turns
