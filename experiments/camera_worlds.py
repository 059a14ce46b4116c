"""Simulated campaigns of one camera: hidden errors of both sides, sessions' answers with their stated covariances.

Pure statistics: no depth image, no finger. A session's answer is drawn from what sessions are like: directions measured
well and badly, some not at all; errors mostly smaller than stated and now and then three times as large.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from pretouch_orchestrator.calibration import Calibration, Observation, estimate_calibration
from pretouch_orchestrator.calibration.observation import difference

from pretouch.geometry import Array, Pose, rotation_from_vector, vector_from_rotation
from pretouch.prior import AnyPrior, Prior

ANGLE, SHIFT = np.radians(5), 0.02
"""rad and m: half widths of the calibration error by roll, pitch, yaw and base axis, as in `pretouch evaluate`."""
RESIDUAL_ROTATION, RESIDUAL_TRANSLATION = np.radians(0.4), 0.002
CONVERGED = np.diag([np.radians(0.3)] * 3 + [0.001] * 3) ** 2
_TAIL_SHARE, _TAIL, _BULK = 0.08, 3.0, 0.6


class Residual(StrEnum):
    """What differs from session to session."""

    NORMAL = "normal"
    UNIFORM = "uniform"
    HEAVY = "heavy"
    """Student's t of 3 degrees of freedom, of the same variance."""
    CORRELATED = "correlated"
    """Each session's is 0.8 of the last one's and something new."""
    CAMERA = "camera"
    """About the camera's own origin: what turns there shifts the object."""
    POSE = "pose"
    """A smooth function of the camera's place, such as wrong kinematics, and a third of it by chance."""


@dataclass(frozen=True)
class World:
    """A kind of campaign.

    Attributes:
        residual: its distribution.
        scale: of the residual, times 2 mm and 0.4 deg.
        moving: whether the camera is elsewhere in each session.
        wrong: share of sessions that are confidently wrong by 3 cm and 8 deg.
        weak: share of sessions that measure next to nothing.
        converged: whether every session knows its answer to 1 mm and 0.3 deg along each axis, as stated.
    """

    residual: Residual = Residual.NORMAL
    scale: float = 1.0
    moving: bool = False
    wrong: float = 0.0
    weak: float = 0.0
    converged: bool = False


@dataclass(frozen=True)
class Knock:
    """The camera is pushed (m) and turned (rad), about its own origin or, if not `about_camera`, about the object."""

    session: int
    shift: float = 0.0
    turn: float = 0.0
    about_camera: bool = True


@dataclass(eq=False)
class Session:
    """What was predicted for a session and what was true; `chi2` with 6 degrees of freedom."""

    prior: AnyPrior
    known: bool
    chi2: float
    error: float
    calibration: Calibration
    wrong: bool = False


@dataclass(eq=False)
class Campaign:
    """A camera, its hidden errors, and the sessions so far."""

    world: World
    rng: np.random.Generator
    knock: Knock | None = None
    observations: list[Observation] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._azimuth = self.rng.uniform(-np.pi, np.pi)
        self._home = self._place_camera(0.0)
        split = self.rng.uniform(0, np.pi / 2)
        pivot = np.array([0.0, 0.0, 0.9])
        self._camera_error = _draw_error(self.rng, pivot, np.sin(split))
        self._base_error = _draw_error(self.rng, np.zeros(3), np.cos(split))
        self._last = np.zeros(6)
        self._waves = self.rng.normal(size=(6, 3, 2)) * 2.0

    def run(self, sessions: int) -> list[Session]:
        return [self.step(k) for k in range(sessions)]

    def step(self, k: int) -> Session:
        """One session: predicted, held, added."""
        calibration = estimate_calibration(self.observations)
        camera, centroid, truth = self._draw(k)
        prediction = calibration.predict(camera, centroid)
        prior = Prior() if prediction is None else prediction
        off = difference(truth, prior.mean, centroid)
        chi2 = float(off @ np.linalg.solve(prior.covariance, off))
        wrong = bool(self.rng.random() < self.world.wrong)
        self._observe(k, camera, centroid, _wrong_place(self.rng, truth, centroid) if wrong else truth, prior)
        return Session(prior, prediction is not None, chi2, float(np.linalg.norm(off[3:])), calibration, wrong)

    def hold(self, k: int) -> tuple[Pose, Array, Pose]:
        """One session from the default prior, without a prediction: believed pose, centroid (3,) and truth."""
        camera, centroid, truth = self._draw(k)
        self._observe(k, camera, centroid, truth, Prior())
        return camera, centroid, truth

    def _draw(self, k: int) -> tuple[Pose, Array, Pose]:
        camera = self._place_camera(np.radians(35)) if self.world.moving else self._home
        centroid = np.append(self.rng.uniform(-0.15, 0.15, 2), self.rng.uniform(0.02, 0.1))
        return camera, centroid, self._truth(k, camera, centroid)

    def _place_camera(self, spread: float) -> Pose:
        azimuth = self._azimuth + self.rng.uniform(-spread, spread)
        down, distance = np.radians(self.rng.uniform(40, 50)), self.rng.uniform(0.8, 1.0)
        back = np.array([np.cos(down) * np.cos(azimuth), np.cos(down) * np.sin(azimuth), np.sin(down)])
        x = np.cross([0.0, 0.0, 1.0], back)
        x /= np.linalg.norm(x)
        return Pose.of(np.stack([x, np.cross(-back, x), -back], axis=1), distance * back)

    def _truth(self, k: int, camera: Pose, centroid: Array) -> Pose:
        in_camera = camera.inverse().apply(centroid)
        if self.knock is not None and k == self.knock.session:
            pivot = np.zeros(3) if self.knock.about_camera else in_camera
            push = self.knock.shift * _direction(self.rng)
            self._camera_error = about(pivot, self.knock.turn * _direction(self.rng), push) @ self._camera_error
        residual = self._draw_residual(camera)
        pivot = np.zeros(3) if self.world.residual is Residual.CAMERA else in_camera
        own = about(pivot, residual[:3], residual[3:])
        return self._base_error @ camera @ self._camera_error @ own @ camera.inverse()

    def _draw_residual(self, camera: Pose) -> Array:
        kind, rng = self.world.residual, self.rng
        draws = rng.normal(size=6)
        if kind is Residual.UNIFORM:
            draws = rng.uniform(-np.sqrt(3), np.sqrt(3), 6)
        elif kind is Residual.HEAVY:
            draws = draws / np.sqrt(rng.chisquare(3) / 3) / np.sqrt(3)
        elif kind is Residual.CORRELATED:
            draws = 0.8 * self._last + 0.6 * draws
            self._last = draws
        elif kind is Residual.POSE:
            phases = self._waves[..., 0] @ camera.translation + self._waves[:, 0, 1]
            draws = np.sqrt(8 / 9) * np.sqrt(2) * np.sin(phases) + draws / 3
        stds = np.array([RESIDUAL_ROTATION] * 3 + [RESIDUAL_TRANSLATION] * 3)
        return np.asarray(self.world.scale * stds * draws, dtype=np.float64)

    def _observe(self, k: int, camera: Pose, centroid: Array, truth: Pose, prior: AnyPrior) -> None:
        """The session's answer: the product of its prior and of what its samples say."""
        own = _draw_covariance(self.rng, self.rng.random() < self.world.weak)
        scale = _TAIL if self.rng.random() < _TAIL_SHARE else _BULK
        if self.world.converged:
            own, scale = CONVERGED, 1.0
        off = difference(truth, prior.mean, centroid) + scale * self.rng.multivariate_normal(np.zeros(6), own)
        gain = prior.covariance @ np.linalg.inv(prior.covariance + own)
        found = gain @ off
        covariance = (np.eye(6) - gain) @ prior.covariance
        image = prior.mean.apply(centroid)
        correction = about(image, found[:3], found[3:]) @ prior.mean
        self.observations.append(
            Observation(
                f"session-{k:05d}", 60.0 * k, camera, correction, centroid, covariance, prior.mean, prior.covariance
            )
        )


def about(pivot: Array, turn: Array, shift: Array) -> Pose:
    """Turns by the rotation vector (3,), rad, about the pivot (3,), m, then shifts by (3,), m."""
    rotation = rotation_from_vector(turn)
    return Pose.of(rotation, pivot - rotation @ pivot + shift)


def _draw_error(rng: np.random.Generator, pivot: Array, share: float) -> Pose:
    roll, pitch, yaw = rng.uniform(-ANGLE, ANGLE, 3)
    turn = rotation_from_vector([0, 0, yaw]) @ rotation_from_vector([0, pitch, 0]) @ rotation_from_vector([roll, 0, 0])
    return about(pivot, share * vector_from_rotation(turn), share * rng.uniform(-SHIFT, SHIFT, 3))


def _draw_covariance(rng: np.random.Generator, weak: bool) -> Array:
    """A session's own covariance (6, 6): some 1.2 mm and 0.8 deg, by direction from half of it to twice; in every third
    one direction unknown; a weak session six times as wide."""
    stds = np.array([np.radians(0.8)] * 3 + [0.0012] * 3) * np.exp(rng.normal(size=6) * 0.5 + rng.normal() * 0.4)
    stds = stds * (6.0 if weak else 1.0)
    turns = np.zeros((6, 6))
    turns[:3, :3], turns[3:, 3:] = (rotation_from_vector(rng.normal(size=3) * 2) for _ in range(2))
    if rng.random() < 1 / 3:
        unknown = int(rng.integers(6))
        stds[unknown] = 1.0
    mixed = turns * stds
    return np.asarray(mixed @ mixed.T, dtype=np.float64)


def _wrong_place(rng: np.random.Generator, truth: Pose, centroid: Array) -> Pose:
    image = truth.apply(centroid)
    return about(image, np.radians(8) * _direction(rng), 0.03 * _direction(rng)) @ truth


def _direction(rng: np.random.Generator) -> Array:
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector), dtype=np.float64)
