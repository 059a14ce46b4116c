"""One session's result as the estimator takes it, and what it says beyond the prior that it started from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pretouch.errors import InvalidInput
from pretouch.geometry import Array, Matrix6, Pose, Vector3, frozen_array, vector_from_rotation

_FLOOR_STD = 1e-4
"""m or rad: no session is taken to know a direction better than this."""
_MIN_GAIN = 0.25
"""Information gained, as a share of the prior's, from which a direction counts: the answer's error is divided by it."""


@dataclass(frozen=True, eq=False)
class Observation:
    """What one session found, and the prior that it started from.

    Attributes:
        session_id: the session.
        at: when it ended, in s since the epoch.
        base_T_camera: the camera's pose as the client believed it.
        base_T_correction: the session's answer.
        centroid: mean c of the object's cloud in base before correction, in metres.
        covariance: 6 x 6, as in `pretouch.estimate.Estimate`.
        prior_mean: base_T_correction as the session's prior had it.
        prior_covariance: 6 x 6, in the order and sense of `covariance`.

    Raises:
        Malformed: a value is not finite.
        InvalidInput: a covariance that is not positive definite.
    """

    session_id: str
    at: float
    base_T_camera: Pose
    base_T_correction: Pose
    centroid: Vector3
    covariance: Matrix6
    prior_mean: Pose
    prior_covariance: Matrix6

    def __post_init__(self) -> None:
        object.__setattr__(self, "at", float(frozen_array(self.at, (), "at")))
        object.__setattr__(self, "centroid", frozen_array(self.centroid, (3,), "centroid"))
        for name in ("covariance", "prior_covariance"):
            covariance = frozen_array(getattr(self, name), (6, 6), name)
            symmetric = 0.5 * (covariance + covariance.T)
            least = float(np.linalg.eigvalsh(symmetric)[0])
            if least < -1e-9 or np.diag(symmetric).min() <= 0:
                raise InvalidInput(
                    f"{name} has the eigenvalue {least:.2g}.",
                    "Send a positive definite covariance in rad^2, rad m, m^2.",
                )
            object.__setattr__(self, name, frozen_array(symmetric, (6, 6), name))


class Measurement(NamedTuple):
    """What a session says about the error of its own answer, its prior removed: `rows @ error` is normal.

    Attributes:
        rows: (k, 6), the directions that it measured, k from 0 to 6; they act on an error as in `difference`.
        values: (k,), their means.
        variances: (k,), the variances of the independent errors of `values`.
    """

    rows: Array
    values: Array
    variances: Array


def difference(a: Pose, b: Pose, point: Array) -> Array:
    """(6,): how the correction `a` differs from `b` at the point (3,): (log(R_a R_b^T), a point - b point)."""
    return np.concatenate([vector_from_rotation(a.rotation @ b.rotation.T), a.apply(point) - b.apply(point)])


def remove_prior(observation: Observation) -> Measurement:
    """The session's own evidence: the difference between its information and its prior's.

    With the prior whitened (covariance I, mean -m from the answer) and the answer's information of eigenvalues l, the
    samples alone had the information l - 1 and the mean m / (l - 1), which is the update of a normal prior solved for
    the measurement. Directions that the session hardly learned anything about are left out.
    """
    floor = _FLOOR_STD**2 * np.eye(6)
    root = np.linalg.cholesky(observation.prior_covariance + floor)
    whiten = np.linalg.inv(root)
    covariance = whiten @ (observation.covariance + floor) @ whiten.T
    values, vectors = np.linalg.eigh(covariance)
    gain = 1.0 / values - 1.0
    learned = gain >= _MIN_GAIN
    rows = (vectors.T @ whiten)[learned]
    off = rows @ difference(observation.base_T_correction, observation.prior_mean, observation.centroid)
    return Measurement(rows, off / gain[learned], 1.0 / gain[learned])
