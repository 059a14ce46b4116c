"""The calibration error that the robot does not know, and how far an estimate is from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from examples.physics_arm.camera import View
from pretouch.estimate import Estimate
from pretouch.geometry import Array, Pose, rotation_from_vector, vector_from_rotation

_SHIFT, _TURN = 0.02, np.radians(5.0)
"""m and rad: each axis is off by up to this, uniformly."""
_REGION = 12.59
"""Squared Mahalanobis distance within which 95 % of a six-dimensional normal lie."""


@dataclass(frozen=True, eq=False)
class Truth:
    """What would be the right answer.

    Attributes:
        believed: base_T_camera as the robot has it.
        base_T_correction: maps a point from where `believed` puts it to where it is.
        points: (n, 3), m, in base: the object's seen surface as `believed` puts it.
    """

    believed: Pose
    base_T_correction: Pose
    points: Array

    @staticmethod
    def hidden(view: View, random: np.random.Generator) -> Truth:
        """Roll, pitch and yaw about the object's centroid, then a shift."""
        roll, pitch, yaw = random.uniform(-_TURN, _TURN, 3)
        rotation = (
            rotation_from_vector([0, 0, yaw]) @ rotation_from_vector([0, pitch, 0]) @ rotation_from_vector([roll, 0, 0])
        )
        shift = random.uniform(-_SHIFT, _SHIFT, 3)
        centroid = view.base_T_camera.apply(view.object_points).mean(axis=0) - shift
        correction = Pose.of(rotation, centroid + shift - rotation @ centroid)
        believed = correction.inverse() @ view.base_T_camera
        return Truth(believed, correction, believed.apply(view.object_points))

    def error(self, base_T_correction: Pose) -> float:
        """m: mean distance of the object's points from where they are."""
        wrong = base_T_correction.apply(self.points) - self.base_T_correction.apply(self.points)
        return float(np.linalg.norm(wrong, axis=1).mean())

    def is_covered(self, estimate: Estimate) -> bool:
        """Whether the truth lies in the estimate's 95 % region."""
        turn = vector_from_rotation(self.base_T_correction.rotation @ estimate.base_T_correction.rotation.T)
        c = estimate.centroid
        shift = self.base_T_correction.apply(c) - estimate.base_T_correction.apply(c)
        off = np.concatenate([turn, shift])
        return bool(off @ np.linalg.solve(estimate.covariance, off) <= _REGION)
