"""What is believed of the camera's calibration error before the first scan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pretouch.errors import InvalidInput
from pretouch.geometry import Array, Matrix6, Pose, frozen_array, vector_from_rotation

MAX_SHIFT = 0.5
"""m: how far a prior's mean may move the object's centroid."""
MAX_TURN = float(np.radians(45))
"""rad: how far a prior's mean may turn the object."""
_MIN_STD, _MAX_STD = 1e-6, 1.0
"""m or rad, bounds of a standard deviation: a much smaller variance would be lost in rounding errors."""
_FLOOR_STD = 1e-5
"""m or rad: the standard deviation of a direction that a covariance says to be known better than this."""
CONTRADICTION = 22.46
"""Squared Mahalanobis distance of six components that one error in a thousand exceeds: beyond it a prior is wrong."""
_ROUNDING = 1e-6
"""Share of sqrt(c_ii c_jj) that counts as a rounding error of c_ij."""


@dataclass(frozen=True)
class Prior:
    """An unbiased calibration error, as large along every axis: nearly uniform up to sqrt 3 standard deviations.

    The defaults have the standard deviations of uniform errors of +-2 cm and +-5 deg.

    Attributes:
        translation_std: standard deviation of the translation along each base axis, in metres.
        rotation_std: standard deviation of the rotation about each base axis through the object's centroid, in radians.

    Raises:
        Malformed: a value is not finite.
        InvalidInput: a value out of its limits.
    """

    translation_std: float = 0.0115
    rotation_std: float = 0.05

    def __post_init__(self) -> None:
        for name in ("translation_std", "rotation_std"):
            value = float(frozen_array(getattr(self, name), (), f"prior.{name}"))
            if not _MIN_STD <= value <= _MAX_STD:
                raise InvalidInput(
                    f"prior.{name} is {value:g}.", f"Need a standard deviation of {_MIN_STD:g} to 1 (m or rad)."
                )
            object.__setattr__(self, name, value)

    @property
    def mean(self) -> Pose:
        """`base_T_correction` as expected: none."""
        return Pose.identity()

    @property
    def covariance(self) -> Array:
        """6x6, order (rotation vector, translation)."""
        return np.diag([self.rotation_std**2] * 3 + [self.translation_std**2] * 3)

    def check_mean(self, centroid: Array) -> None:
        """Nothing: see `PosePrior.check_mean`."""

    def is_contradicted_by(self, correction: Pose, centroid: Array, covariance: Array) -> bool:
        """Never: see `PosePrior.is_contradicted_by`."""
        return False

    @property
    def fallback(self) -> Prior:
        """Itself: see `PosePrior.fallback`."""
        return self


@dataclass(frozen=True, eq=False)
class PosePrior:
    """A normal calibration error with any mean and covariance, such as a pose estimator or earlier sessions state.

    Directions that the covariance says to be known better than 0.01 mm or 1e-5 rad are taken to be known so well.

    Attributes:
        base_T_correction: the mean, which maps a point from where the camera put it to where it is expected, both in
            base.
        covariance: 6 x 6, row-major, order (rotation vector, translation), base axes, of the error
            (log(R_true R_mean^T), T_true c - T_mean c) with c the mean of the object's cloud before correction; rad^2,
            rad m, m^2.

    Raises:
        Malformed: a value is not finite.
        InvalidInput: a mean that turns by more than MAX_TURN, or a covariance that is not symmetric, not positive
            semidefinite or out of its limits.
    """

    base_T_correction: Pose
    covariance: Matrix6

    def __post_init__(self) -> None:
        turn = float(np.linalg.norm(vector_from_rotation(self.base_T_correction.rotation)))
        if turn > MAX_TURN:
            raise InvalidInput(
                f"prior.base_T_correction turns by {np.degrees(turn):.1f} deg.",
                f"Need at most {np.degrees(MAX_TURN):.0f} deg: correct base_T_camera itself by it first.",
            )
        object.__setattr__(self, "covariance", _check_covariance(frozen_array(self.covariance, (6, 6), _COVARIANCE)))

    @property
    def mean(self) -> Pose:
        """`base_T_correction` as expected."""
        return self.base_T_correction

    @property
    def translation_std(self) -> float:
        """m: the standard deviation of the centroid's translation along the axis where it is largest."""
        return _largest_std(self.covariance[3:, 3:])

    @property
    def rotation_std(self) -> float:
        """rad: the standard deviation of the rotation about the axis where it is largest."""
        return _largest_std(self.covariance[:3, :3])

    def check_mean(self, centroid: Array) -> None:
        """Raises `InvalidInput` if the mean moves the object's centroid (3,), m, in base, by more than MAX_SHIFT."""
        shift = float(np.linalg.norm(self.base_T_correction.apply(centroid) - centroid))
        if shift > MAX_SHIFT:
            raise InvalidInput(
                f"prior.base_T_correction moves the object by {shift:.3g} m.",
                f"Need at most {MAX_SHIFT:g} m: check its unit and that it maps base to base, or correct base_T_camera "
                "itself by it first.",
            )

    def is_contradicted_by(self, correction: Pose, centroid: Array, covariance: Array) -> bool:
        """Whether an estimate is too far from the mean for both to be right: it was then made without this prior.

        Args:
            correction: `base_T_correction` of the estimate.
            centroid: (3,), m, in base, before correction.
            covariance: (6, 6) of the estimate.
        """
        turn = vector_from_rotation(correction.rotation @ self.mean.rotation.T)
        apart = np.concatenate([turn, correction.apply(centroid) - self.mean.apply(centroid)])
        return bool(apart @ np.linalg.solve(self.covariance + covariance, apart) > CONTRADICTION)

    def carried(self, before: Array, after: Array) -> PosePrior:
        """The same belief about another point: of another object's centroid `after`, where this one is about `before`.

        T_true c' - T_mean c' = (T_true c - T_mean c) + (R_true - R_mean)(c' - c), which is d + w x R_mean (c' - c) for
        small errors (w, d).

        Args:
            before, after: (3,), m, in base before correction.
        """
        x, y, z = self.mean.rotate(np.subtract(after, before))
        carry = np.eye(6)
        carry[3:, :3] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
        return PosePrior(self.mean, carry @ self.covariance @ carry.T)

    @property
    def fallback(self) -> Prior:
        """What is believed of errors about the mean once samples contradict the covariance: the default, or more."""
        usual = Prior()
        return Prior(
            min(max(usual.translation_std, self.translation_std), _MAX_STD),
            min(max(usual.rotation_std, self.rotation_std), _MAX_STD),
        )


AnyPrior = Prior | PosePrior
"""Both have `mean`, `covariance` (6, 6) and the largest standard deviations `translation_std` and `rotation_std`."""

_COVARIANCE = "prior.covariance"


def _check_covariance(covariance: Array) -> Array:
    """The covariance (6, 6), symmetric to the bit, no direction narrower than _FLOOR_STD; raises `InvalidInput`."""
    variances = np.diag(covariance)
    if variances.min() < 0 or variances.max() > _MAX_STD**2:
        k = int(np.argmin(variances) if variances.min() < 0 else np.argmax(variances))
        raise InvalidInput(
            f"{_COVARIANCE}[{k}][{k}] is {variances[k]:g}.",
            f"Need variances from 0 to {_MAX_STD:g} (rad^2 or m^2), in the order rotation vector, translation.",
        )
    scale = np.sqrt(np.outer(variances, variances)) + _FLOOR_STD**2
    skew = np.abs(covariance - covariance.T) / scale
    if skew.max() > _ROUNDING:
        i, j = np.unravel_index(int(skew.argmax()), skew.shape)
        raise InvalidInput(
            f"{_COVARIANCE}[{i}][{j}] is {covariance[i, j]:g}, but [{j}][{i}] is {covariance[j, i]:g}.",
            "Send a symmetric matrix, for example (C + C^T) / 2.",
        )
    symmetric = 0.5 * (covariance + covariance.T)
    least = float(np.linalg.eigvalsh(symmetric / np.sqrt(np.outer(np.diag(scale), np.diag(scale)))).min())
    if least < -_ROUNDING:
        raise InvalidInput(
            f"{_COVARIANCE} has the eigenvalue {least:.2g}, its variances scaled to 1: it is no covariance.",
            "Send a positive semidefinite matrix; a common cause is another order than (rotation vector, translation).",
        )
    values, vectors = np.linalg.eigh(symmetric)
    if values.min() < 0.5 * _FLOOR_STD**2:
        floored = (vectors * np.maximum(values, _FLOOR_STD**2)) @ vectors.T
        symmetric = 0.5 * (floored + floored.T)
    return frozen_array(symmetric, (6, 6), _COVARIANCE)


def _largest_std(covariance: Array) -> float:
    return float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))
