"""What every engine answers."""

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
        others: (k, 6), distinct corrections that agree nearly as well; empty when there is one mode.
        shares: (k + 1,) of the probability: of the best correction's mode, then of the others'; they sum to 1.
        fit: p-value of the samples under the answer.
    """

    x: Array
    covariance: Array
    others: Array = field(default_factory=lambda: np.zeros((0, 6)))
    shares: Array = field(default_factory=lambda: np.ones(1))
    fit: float = 1.0


def correction_of(pose: Pose, centroid: Array) -> Array:
    """x (6,) of a `base_T_correction`, about `centroid` (3,)."""
    return np.concatenate([vector_from_rotation(pose.rotation), pose.apply(centroid) - centroid])


def pose_of(x: Array, centroid: Array) -> Pose:
    """`base_T_correction` of x (6,), about `centroid` (3,)."""
    rotation = rotation_from_vector(x[:3])
    return Pose.of(rotation, centroid + x[3:] - rotation @ centroid)
