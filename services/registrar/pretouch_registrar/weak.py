"""The directions in which a pose is still free, in words."""

from __future__ import annotations

import numpy as np

from pretouch.estimate import WeakDirection
from pretouch.geometry import Array

FREE_STD = 0.003
"""m: a direction with a larger standard deviation is called free."""
_AXES = ("x", "y", "z")


def weak_directions(covariance: Array, radius: float, up: Array) -> tuple[WeakDirection, ...]:
    """The principal axes of `covariance` (6, 6) with a standard deviation above FREE_STD, the weakest first.

    Rotations are scaled by the object's radius, m, so that both halves are metres; `up` (3,) is the table's normal.
    """
    scale = np.array([radius] * 3 + [1.0] * 3)
    values, vectors = np.linalg.eigh(covariance * np.outer(scale, scale))
    weak = []
    for value, vector in sorted(zip(values, vectors.T, strict=True), key=lambda pair: -pair[0]):
        std = float(np.sqrt(max(value, 0.0)))
        if std > FREE_STD:
            signed = vector * np.sign(vector[np.argmax(np.abs(vector))])
            weak.append(WeakDirection(signed, std, f"{_words(signed, up)}, +-{1000 * std:.1f} mm"))
    return tuple(weak)


def _words(direction: Array, up: Array) -> str:
    turn, shift = direction[:3], direction[3:]
    parts = []
    if np.linalg.norm(turn) > 0.35:
        parts.append(f"rotation about {_axis(turn / np.linalg.norm(turn), up, 'through the object')}")
    if np.linalg.norm(shift) > 0.35:
        parts.append(f"translation along {_axis(shift / np.linalg.norm(shift), up, 'of the table')}")
    return " with ".join(parts)


def _axis(axis: Array, up: Array, of: str) -> str:
    if abs(axis @ up) > 0.9:
        return f"the vertical {of}"
    along = int(np.argmax(np.abs(axis)))
    if abs(axis[along]) > 0.95:
        return f"base {_AXES[along]}"
    text = ", ".join(f"{value:+.2f}" for value in axis * np.sign(axis[along]))
    return f"({text}) in base"
