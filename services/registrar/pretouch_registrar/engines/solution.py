"""What every engine returns."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pretouch.geometry import Array, Pose, rotation_from_vector, vector_from_rotation


@dataclass(frozen=True, eq=False)
class Solution:
    """A correction x = (w, d): p -> exp(w) (p - c) + c + d with c the object's centroid, base axes; rad and m.

    Attributes:
        x: (6,), the best correction.
        covariance: (6, 6) of its error.
        other_modes: (k, 6), distinct corrections that explain the samples nearly as well; empty if there is one mode.
        mode_weights: (k + 1,), the probability of the best correction's mode and of the others; they sum to 1.
        fit: p-value of the samples under the solution.
    """

    x: Array
    covariance: Array
    other_modes: Array = field(default_factory=lambda: np.zeros((0, 6)))
    mode_weights: Array = field(default_factory=lambda: np.ones(1))
    fit: float = 1.0


def correction_from_pose(pose: Pose, centroid: Array) -> Array:
    """x (6,) of a `base_T_correction`, about `centroid` (3,)."""
    return np.concatenate([vector_from_rotation(pose.rotation), pose.apply(centroid) - centroid])


def pose_from_correction(x: Array, centroid: Array) -> Pose:
    """`base_T_correction` of x (6,), about `centroid` (3,)."""
    rotation = rotation_from_vector(x[:3])
    return Pose.of(rotation, centroid + x[3:] - rotation @ centroid)
