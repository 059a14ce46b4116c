"""Real pose pairs as a camera's sessions: a calibration from some of the pairs, and its errors on others."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pretouch_orchestrator.calibration import Observation, estimate_calibration
from pretouch_orchestrator.calibration.observation import difference

from experiments.hand_eye import Track, pair, read_track, solve, spread
from pretouch.geometry import Array, Pose
from pretouch.prior import AnyPrior, Prior

_PAIRS = 400
"""Pairs of which the whole recording's calibration is made."""
_CALIBRATION, _WINDOW = 20, 0.25
"""Pairs of the calibration that a campaign believes, and the share of the recording that they are taken from."""
_STATED = np.diag([np.radians(0.1)] * 3 + [0.0005] * 3) ** 2
"""What a pair is taken to know of its own error."""


@dataclass(frozen=True, eq=False)
class Recording:
    """Pairs of one clock, and their calibration as a whole.

    Attributes:
        name: of the hand's file.
        hand: base_T_hand.
        camera: camera_T_target.
        offset: s, of the camera's clock.
        hand_T_camera, base_T_target: from all pairs.
    """

    name: str
    hand: Track
    camera: Track
    offset: float
    hand_T_camera: Pose
    base_T_target: Pose

    def residuals(self) -> tuple[Array, Array]:
        """(n,), m, and (n,), rad: by how much the pairs disagree with the calibration of all."""
        places = [self.hand.pose(k) @ self.hand_T_camera @ self.camera.pose(k) for k in range(len(self.hand.times))]
        off = np.stack([difference(place, self.base_T_target, np.zeros(3)) for place in places])
        shifts = [place.translation - self.base_T_target.translation for place in places]
        return np.linalg.norm(shifts, axis=1), np.linalg.norm(off[:, :3], axis=1)


@dataclass(frozen=True, eq=False)
class PairSession:
    """Attributes: position in its campaign; the prior; the error before it (6,) and after it, whitened (6,)."""

    position: int
    prior: AnyPrior
    error: Array
    z: Array
    alarm: bool


def read_recording(hand_path: Path, camera_path: Path) -> Recording:
    """Both tracks paired. The camera's may hold its pose in the target's frame or the target's in its own: the one that
    fits is taken."""
    hand, camera, offset = pair(read_track(hand_path), read_track(camera_path))
    thin = spread(len(hand.times), _PAIRS)
    found = []
    for direction in (camera, camera.inverse()):
        solved = solve(hand.part(thin), direction.part(thin))
        recording = Recording(hand_path.stem, hand, direction, offset, *solved)
        found.append((float(np.median(recording.residuals()[0])), recording))
    return min(found, key=lambda one: one[0])[1]


def run_campaign(recording: Recording, rng: np.random.Generator, sessions: int) -> list[PairSession]:
    """A calibration from pairs of one stretch of the recording, then sessions at other times of it, in order."""
    count = len(recording.hand.times)
    width = int(_WINDOW * count)
    start = int(rng.integers(count - width))
    chosen = np.sort(start + rng.choice(width, _CALIBRATION, replace=False))
    believed, _ = solve(recording.hand.part(chosen), recording.camera.part(chosen))
    others = np.delete(np.arange(count), np.arange(start, start + width))
    seen: list[Observation] = []
    rows = []
    for position, k in enumerate(np.sort(rng.choice(others, sessions, replace=False)), start=1):
        base_T_camera = recording.hand.pose(k) @ believed
        placed = base_T_camera @ recording.camera.pose(k)
        truth = recording.base_T_target @ placed.inverse()
        calibration = estimate_calibration(seen)
        prior = calibration.predict(base_T_camera, placed.translation) or Prior()
        off = difference(truth, prior.mean, placed.translation)
        z = np.linalg.solve(np.linalg.cholesky(prior.covariance), off)
        error = difference(truth, Pose.identity(), placed.translation)
        rows.append(PairSession(position, prior, error, z, calibration.drift.state != "steady"))
        default = Prior()
        seen.append(
            Observation(
                session_id=f"pair-{k:06d}",
                at=float(recording.hand.times[k]),
                base_T_camera=base_T_camera,
                base_T_correction=truth,
                centroid=placed.translation,
                covariance=_STATED,
                prior_mean=default.mean,
                prior_covariance=10000 * default.covariance,  # a pair has no prior: its error is seen, not estimated
            )
        )
    return rows
