"""The estimate: a corrected pose with its uncertainty; and the prior."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pretouch.errors import InvalidInput
from pretouch.geometry import Array, Pose, frozen_array

_HALF = np.random.default_rng(0).standard_normal((512, 6))
_NORMAL = np.concatenate([_HALF, -_HALF])
_MAX_POINTS = 64
MIN_FIT = 0.01
"""p-value below which an estimate is taken not to explain its samples: one good session in a hundred is rejected."""
_ROUNDING = 1e-6
"""Largest rounding error of a sum of probabilities."""
_SAME_CORRECTION = 1e-6
"""m, or an entry of the rotation matrix: two corrections that differ by less are the same."""
_MIN_STD = 1e-6
"""m or rad, least standard deviation: a much smaller variance would be lost in rounding errors."""


@dataclass(frozen=True)
class Prior:
    """The distribution of the camera's calibration error before the first scan: normal, with zero mean.

    Attributes:
        translation_std: m, per base axis. The default is uniform +-2 cm as a normal: 2 cm / sqrt 3.
        rotation_std: rad, per base axis, about the object's centroid. The default is uniform +-5 deg as a normal.
    """

    translation_std: float = 0.0115
    rotation_std: float = 0.05

    def __post_init__(self) -> None:
        for name in ("translation_std", "rotation_std"):
            value = float(frozen_array(getattr(self, name), (), f"prior.{name}"))
            if not _MIN_STD <= value <= 1:
                raise InvalidInput(
                    f"prior.{name} is {value:g}.", f"Need a standard deviation of {_MIN_STD:g} to 1 (m or rad)."
                )
            object.__setattr__(self, name, value)

    def covariance(self) -> Array:
        """6x6, order (rotation vector, translation)."""
        return np.diag([self.rotation_std**2] * 3 + [self.translation_std**2] * 3)

    def inverse_variances(self) -> Array:
        """(6,), the diagonal of the inverse covariance, in the same order."""
        return np.array([self.rotation_std**-2.0] * 3 + [self.translation_std**-2.0] * 3)


@dataclass(frozen=True, eq=False)
class WeakDirection:
    """A weakly observable direction of the pose.

    Attributes:
        direction: unit (6,), order (rotation vector scaled by the object's radius, translation), base axes.
        std: m, standard deviation along it.
        text: the direction in words.
    """

    direction: Array
    std: float
    text: str


@dataclass(frozen=True, eq=False)
class Mode:
    """A mode of the posterior: a correction that explains the samples.

    Attributes:
        base_T_correction: maps a point where the camera put it to where this mode puts it, both in base.
        weight: in (0, 1], the probability of this mode among those of its estimate.

    Raises:
        InvalidInput: a weight out of its limits.
        Malformed: a weight that is not finite.
    """

    base_T_correction: Pose
    weight: float

    def __post_init__(self) -> None:
        weight = float(frozen_array(self.weight, (), "modes.weight"))
        if not 0 < weight <= 1 + _ROUNDING:
            raise InvalidInput(f"modes.weight is {weight:g}.", "Need a probability above 0, at most 1.")
        object.__setattr__(self, "weight", weight)


@dataclass(frozen=True, eq=False)
class Estimate:
    """A corrected pose with its uncertainty.

    Attributes:
        base_T_correction: maps a point where the camera put it to where it truly is, both in base.
        centroid: (3,), m, the mean of the object's cloud in base before correction.
        covariance: 6x6, order (rotation vector, translation), base axes, of the error
            (log(R_true R_est^T), T_true c - T_est c); rad^2, rad m, m^2.
        expected_error: m, expectation, over the covariance, of the mean distance of estimated from true object points.
        error_quantile: m, the 95 % quantile of the same.
        unobservable: the weakly observable directions, the weakest first.
        inliers: samples that agree with the estimate.
        samples: samples used.
        rmse: m, root mean square residual of the inliers; 0 without any.
        modes: the modes of the posterior, that of `base_T_correction` first; their weights sum to 1. By default there
            is that one only. The covariance covers all of them.
        fit: in [0, 1], the p-value of the samples under the estimate: the probability that samples of the object at
            that pose would fit it no better than these. 1 before the first scan.
        sensor_problem: why the samples are no measurements (stuck, dead, noise that no sensor has, a unit off by 10 or
            1000), in one sentence; empty: they are. The REST contract shows it in a session's reason only.

    Raises:
        InvalidInput: a fit out of its limits, mode weights that do not sum to 1, or a first mode that differs.
        Malformed: a fit that is not finite.
    """

    base_T_correction: Pose
    centroid: Array
    covariance: Array
    expected_error: float
    error_quantile: float
    unobservable: tuple[WeakDirection, ...] = ()
    inliers: int = 0
    samples: int = 0
    rmse: float = 0.0
    modes: tuple[Mode, ...] = ()
    fit: float = 1.0
    sensor_problem: str = ""

    def __post_init__(self) -> None:
        fit = float(frozen_array(self.fit, (), "estimate.fit"))
        if not 0 <= fit <= 1:
            raise InvalidInput(f"estimate.fit is {fit:g}.", "Need a p-value, from 0 to 1.")
        modes = self.modes or (Mode(self.base_T_correction, 1.0),)
        total = sum(mode.weight for mode in modes)
        if abs(total - 1) > _ROUNDING:
            raise InvalidInput(f"The weights of estimate.modes sum to {total:g}.", "Need a sum of 1.")
        if not np.allclose(
            modes[0].base_T_correction.matrix, self.base_T_correction.matrix, rtol=0, atol=_SAME_CORRECTION
        ):
            raise InvalidInput(
                "The first of estimate.modes is another place than estimate.base_T_correction.",
                "Name the answer itself first.",
            )
        object.__setattr__(self, "fit", fit)
        object.__setattr__(self, "modes", tuple(modes))


def point_error(
    covariance: ArrayLike, points: ArrayLike, centroid: ArrayLike, quantiles: ArrayLike = (0.95,)
) -> tuple[float, Array]:
    """The mean point error under a pose covariance, by 1024 fixed draws.

    A pose error (w, d) moves the point p by about w x (p - c) + d.

    Args:
        covariance: 6x6 as in `Estimate`.
        points: (n, 3), m, the object's points as estimated.
        centroid: (3,), m, as estimated.
        quantiles: (k,) in (0, 1).

    Returns:
        The expectation, m, and the quantiles (k,), m.
    """
    arms = np.asarray(points, dtype=np.float64)
    arms = arms[:: max(1, len(arms) // _MAX_POINTS)] - np.asarray(centroid, dtype=np.float64)
    values, vectors = np.linalg.eigh(np.asarray(covariance, dtype=np.float64))
    draws = _NORMAL @ (vectors * np.sqrt(np.maximum(values, 0.0))).T
    x, y, z = arms.T
    (wx, wy, wz), (dx, dy, dz) = draws.T[:3, :, None], draws.T[3:, :, None]
    squares = (wy * z - wz * y + dx) ** 2 + (wz * x - wx * z + dy) ** 2 + (wx * y - wy * x + dz) ** 2
    errors = np.sqrt(squares).mean(axis=1)
    return float(errors.mean()), np.quantile(errors, np.asarray(quantiles, dtype=np.float64))


def from_prior(prior: Prior, cloud: Array) -> Estimate:
    """The estimate before the first scan: identity and the prior; `cloud` (n, 3), m, is the object's in base."""
    centroid = cloud.mean(axis=0)
    expected, quantile = point_error(prior.covariance(), cloud, centroid)
    return Estimate(Pose.identity(), centroid, prior.covariance(), expected, float(quantile[0]))
