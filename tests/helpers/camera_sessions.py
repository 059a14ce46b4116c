"""Sessions of one camera with known errors of both sides, for the estimator of calibrations."""

from __future__ import annotations

import numpy as np
from pretouch_orchestrator.calibration import Observation

from pretouch.geometry import Array, Pose, rotation_from_vector
from pretouch.prior import AnyPrior, Prior

STATED = np.diag([0.01] * 3 + [0.001] * 3) ** 2
"""A session's own covariance: 0.01 rad and 1 mm."""


def turned(turn: Array, shift: Array, pivot: Array) -> Pose:
    """Turns by the rotation vector (3,), rad, about the pivot (3,), then shifts by (3,), m."""
    rotation = rotation_from_vector(turn)
    return Pose.of(rotation, pivot - rotation @ pivot + shift)


def camera_at(azimuth: float, distance: float = 0.9) -> Pose:
    """A camera that looks 45 deg down at the origin of base."""
    back = np.array([np.cos(azimuth), np.sin(azimuth), 1.0]) / np.sqrt(2)
    x = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    return Pose.of(np.stack([x, np.cross(-back, x), -back], axis=1), distance * back)


def session(k: int, camera: Pose, true_camera: Pose, centroid: Array, prior: AnyPrior | None = None) -> Observation:
    """The session number k of a camera believed at `camera` that is at `true_camera`, whose samples were exact."""
    prior = prior or Prior()
    correction = true_camera @ camera.inverse()
    gain = prior.covariance @ np.linalg.inv(prior.covariance + STATED)
    return Observation(
        session_id=f"s{k:04d}",
        at=float(k),
        base_T_camera=camera,
        base_T_correction=_towards(prior.mean, correction, centroid, gain),
        centroid=centroid,
        covariance=(np.eye(6) - gain) @ prior.covariance,
        prior_mean=prior.mean,
        prior_covariance=prior.covariance,
    )


def _towards(start: Pose, end: Pose, centroid: Array, gain: Array) -> Pose:
    from pretouch_orchestrator.calibration.observation import difference

    step = gain @ difference(end, start, centroid)
    return turned(step[:3], step[3:], start.apply(centroid)) @ start


def campaign(
    rng: np.random.Generator, count: int, spread: float, errors: tuple[Pose, Pose] | None = None
) -> list[Observation]:
    """Sessions of a camera within +-spread rad of azimuth, with the errors (E, G), drawn unless given, and residuals of
    1 mm and 0.2 deg."""
    camera_error, base_error = errors or draw_errors(rng)
    seen = []
    for k in range(count):
        camera = camera_at(rng.uniform(-spread, spread))
        centroid = np.append(rng.uniform(-0.1, 0.1, 2), 0.05)
        own = turned(rng.normal(size=3) * 0.0035, rng.normal(size=3) * 0.001, camera.inverse().apply(centroid))
        seen.append(session(k, camera, base_error @ camera @ camera_error @ own, centroid))
    return seen


def draw_errors(rng: np.random.Generator) -> tuple[Pose, Pose]:
    """(E, G) of 2 deg and 8 mm an axis, about an object in front of the camera."""
    in_camera = np.array([0.0, 0.0, 0.9])
    return (
        turned(rng.normal(size=3) * 0.035, rng.normal(size=3) * 0.008, in_camera),
        turned(rng.normal(size=3) * 0.035, rng.normal(size=3) * 0.008, np.zeros(3)),
    )
