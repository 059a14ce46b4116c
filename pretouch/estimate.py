"""The answer: a correction of the object's pose, and its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from pretouch.errors import InvalidInput
from pretouch.expected_error import compute_expected_errors
from pretouch.geometry import Array, Matrix6, Pose, Vector3, Vector6, frozen_array
from pretouch.prior import AnyPrior

_HALF = np.random.default_rng(0).standard_normal((512, 6))
_NORMAL = np.concatenate([_HALF, -_HALF])
_MAX_POINTS = 64
MIN_FIT = 0.01
"""p-value below which an estimate is taken not to explain its samples: one good session in a hundred is rejected."""
_ROUNDING = 1e-6
"""Largest rounding error of a sum of probabilities."""
_SAME_CORRECTION = 1e-6
"""m, or an entry of the rotation matrix: two corrections that differ by less are the same."""


@dataclass(frozen=True, eq=False)
class WeakDirection:
    """A direction in which the samples constrain the pose weakly.

    Attributes:
        direction: unit vector of 6 numbers in base axes: rotation vector scaled by the object's radius, then
            translation.
        std: standard deviation along the direction, in metres.
        text: the direction in words.
        matters: whether one standard deviation along the direction moves the points where the error counts by more than
            a millimetre.
    """

    direction: Vector6
    std: float
    text: str
    matters: bool = True


@dataclass(frozen=True, eq=False)
class Mode:
    """A correction that explains the samples.

    Attributes:
        base_T_correction: maps a point from where the camera put it to where this mode puts it, both in base.
        weight: probability of this mode among the estimate's modes, in (0, 1].

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
    """A correction with its uncertainty. The covariance covers all modes.

    A member is declared here and as a field of `pretouch.v1.Estimate`, with the same words; JSON, messages and the
    OpenAPI description follow from it. REST leaves `sensor_problem` out, which becomes a session's reason there, and
    `engine`, which only recordings need.

    Attributes:
        base_T_correction: maps a point from where the camera put it to where it truly is, both in base.
        centroid: mean c of the object's cloud in base before correction, in metres.
        covariance: 6 x 6, row-major, order (rotation vector, translation), base axes, of the error
            (log(R_true R_est^T), T_true c - T_est c); rad^2, rad m, m^2.
        expected_error: expectation over the covariance of the mean distance between estimated and true points of the
            object, or of the tolerance where it names some, in metres.
        error_quantile: 95 % quantile of that mean distance, in metres.
        unobservable: directions that the samples constrain weakly, the weakest first.
        modes: corrections that explain the samples, this estimate first; the weights sum to 1.
        fit: p-value of the samples under the estimate, in [0, 1]: the probability that samples of an object at this
            pose would agree with it no better than these do; 1 before the first scan.
        inliers: number of samples that agree with the estimate.
        samples: number of samples used.
        rmse: root mean square residual of the inliers, in metres; 0 without inliers.
        sensor_problem: why the samples are not measurements (stuck, dead, too noisy, a wrong unit), in one sentence;
            empty if they are.
        engine: name of the registrar's engine that made the estimate; empty before the first scan.

    Raises:
        InvalidInput: a fit out of its limits, or modes that do not sum to 1 or do not begin with this estimate.
        Malformed: a fit that is not finite.
    """

    base_T_correction: Pose
    centroid: Vector3
    covariance: Matrix6
    expected_error: float
    error_quantile: float
    unobservable: tuple[WeakDirection, ...] = ()
    modes: tuple[Mode, ...] = ()
    fit: float = 1.0
    inliers: int = 0
    samples: int = 0
    rmse: float = 0.0
    sensor_problem: str = field(default="", metadata={"json": False})
    engine: str = field(default="", metadata={"json": False})

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
                "The first of estimate.modes is not estimate.base_T_correction.",
                "Send the estimate itself as the first mode.",
            )
        object.__setattr__(self, "fit", fit)
        object.__setattr__(self, "modes", tuple(modes))


def point_error(
    covariance: ArrayLike, points: ArrayLike, centroid: ArrayLike, quantiles: ArrayLike = (0.95,)
) -> tuple[float, Array]:
    """The mean point error under a pose covariance; its quantiles are those of 1024 fixed draws.

    A pose error (w, d) moves the point p by about w x (p - c) + d.

    Args:
        covariance: 6x6 as in `Estimate`.
        points: (n, 3), m, as estimated: the object's, or those where the error counts.
        centroid: (3,), m, as estimated.
        quantiles: (k,) in (0, 1).

    Returns:
        The expectation, m, and the quantiles (k,), m.
    """
    arms = select_arms(points, centroid)
    values, vectors = np.linalg.eigh(np.asarray(covariance, dtype=np.float64))
    draws = _NORMAL @ (vectors * np.sqrt(np.maximum(values, 0.0))).T
    x, y, z = arms.T
    (wx, wy, wz), (dx, dy, dz) = draws.T[:3, :, None], draws.T[3:, :, None]
    squares = (wy * z - wz * y + dx) ** 2 + (wz * x - wx * z + dy) ** 2 + (wx * y - wy * x + dz) ** 2
    errors = np.sqrt(squares).mean(axis=1)
    expected = float(compute_expected_errors(np.asarray(covariance)[None], arms)[0])
    return expected, np.quantile(errors, np.asarray(quantiles, dtype=np.float64))


def select_arms(points: ArrayLike, centroid: ArrayLike) -> Array:
    """(k, 3), m: some 64 of the points (n, 3), m, evenly in their order, from the centroid (3,), m."""
    arms = np.asarray(points, dtype=np.float64)
    arms = arms[:: max(1, len(arms) // _MAX_POINTS)] - np.asarray(centroid, dtype=np.float64)
    return np.asarray(arms, dtype=np.float64)


def from_prior(prior: AnyPrior, cloud: Array, at: Array | None = None) -> Estimate:
    """The estimate before the first scan: the prior's mean and covariance.

    Args:
        cloud: (n, 3), m, the object's points in base before correction.
        at: (k, 3), m, in base before correction, where the error counts; None: at `cloud`.

    Raises:
        InvalidInput: the prior's mean moves the object too far.
    """
    centroid = cloud.mean(axis=0)
    prior.check_mean(centroid)
    covariance, mean = prior.covariance, prior.mean
    expected, quantile = point_error(covariance, mean.apply(cloud if at is None else at), mean.apply(centroid))
    return Estimate(mean, centroid, covariance, expected, float(quantile[0]))
