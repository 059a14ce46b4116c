"""What is known of a camera's calibration, and what it predicts for the next session."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike

from pretouch.geometry import Array, Pose, frozen_array
from pretouch.prior import MAX_SHIFT, MAX_TURN, PosePrior, Prior
from pretouch_orchestrator.calibration.model import Sides
from pretouch_orchestrator.calibration.observation import difference
from pretouch_orchestrator.calibration.regimes import is_same_place
from pretouch_orchestrator.calibration.residual import in_base


class DriftState(StrEnum):
    """What the latest sessions say about the camera's place."""

    STEADY = "steady"
    SUSPECTED = "suspected"
    """The last session disagrees with those before: it is wrong, or the camera was knocked."""
    MOVED = "moved"
    """Sessions agree with each other and not with those before, which no longer count."""


@dataclass(frozen=True)
class Drift:
    """Whether the camera has moved against its calibration.

    Attributes:
        state: steady, suspected or moved.
        since: the session with which it began, None if steady.
    """

    state: DriftState
    since: str | None = None


@dataclass(frozen=True, eq=False)
class Calibration:
    """The errors of a camera's calibration on its own side (E) and on the base's (G): it is at G B E, believed at B.

    Attributes:
        camera_T_camera: E.
        base_T_base: G.
        covariance: 12 x 12, E first, then G; of each the error (log(R_true R^T), t_true - t) of rotation R and
            translation t; rad^2, rad m, m^2.
        residual: 6 x 6, covariance of what differs from session to session: a small rotation about the object's
            centroid and its translation, in the camera's axes; rad^2, rad m, m^2.
        drift: whether the camera has moved against its calibration.
        rejected: by session that does not count, why.
        count: number of sessions that count.
        widening: factor, at least 1, of the covariance of a prediction: for a residual that is itself uncertain, and
            for sessions that surprised by more than was predicted; less where it would be wider than the default prior.
        base_T_fixed: the declared pose of all sessions that count if it is one and the same in two or more, else None.
    """

    camera_T_camera: Pose = field(default_factory=Pose.identity)
    base_T_base: Pose = field(default_factory=Pose.identity)
    covariance: Array = field(default_factory=lambda: np.zeros((12, 12)))
    residual: Array = field(default_factory=lambda: np.zeros((6, 6)))
    drift: Drift = Drift(DriftState.STEADY)
    rejected: Mapping[str, str] = field(default_factory=dict)
    count: int = 0
    widening: float = 1.0
    base_T_fixed: Pose | None = None

    @property
    def residual_translation_std(self) -> float:
        """m: of `residual`, along an axis, as the root mean square of the three."""
        return float(np.sqrt(np.trace(self.residual[3:, 3:]) / 3))

    @property
    def residual_rotation_std(self) -> float:
        """rad: of `residual`, about an axis through the object's centroid, as the root mean square of the three."""
        return float(np.sqrt(np.trace(self.residual[:3, :3]) / 3))

    def correct(self, base_T_camera: Pose) -> Pose:
        """The camera's pose in base where it is believed at `base_T_camera`: G B E."""
        return self._sides().correct(base_T_camera)

    def predict(self, base_T_camera: Pose, centroid: ArrayLike) -> PosePrior | None:
        """The prior of the next session.

        Args:
            base_T_camera: the camera's pose as believed in that session.
            centroid: (3,), mean of the object's cloud in base before correction, in metres.

        Returns:
            None where nothing better than the default is known: no session counts, the pose is too unlike those seen,
            or another pose is declared for a camera that was fixed, whose error is then another one.
        """
        if self.count == 0 or (self.base_T_fixed is not None and not is_same_place(self.base_T_fixed, base_T_camera)):
            return None
        point = frozen_array(centroid, (3,), "centroid")
        sides = self._sides()
        mean = sides.correction(base_T_camera)
        jacobian = sides.jacobian(base_T_camera, point)
        residual = in_base(self.residual, sides.correct(base_T_camera).rotation)
        covariance = jacobian @ self.covariance @ jacobian.T + residual
        off = difference(mean, Pose.identity(), point)
        widths = np.trace(np.linalg.solve(Prior().covariance, covariance)) / 6
        if widths >= 1 or np.linalg.norm(off[:3]) > MAX_TURN or np.linalg.norm(off[3:]) > MAX_SHIFT:
            return None
        covariance = min(self.widening, 1 / widths) * covariance  # its mean is better known than nothing
        return PosePrior(mean, 0.5 * (covariance + covariance.T))

    def _sides(self) -> Sides:
        return Sides(self.camera_T_camera, self.base_T_base, np.zeros(3), np.zeros(3))
