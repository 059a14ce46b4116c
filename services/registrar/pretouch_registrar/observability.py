"""The weakly observable directions of a pose, and their description in words.

A direction of the pose is a screw: a rotation about some axis with a translation along it. The text names the axis,
says whether the object is symmetric about it, and gives the standard deviation in degrees or millimetres.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from pretouch.estimate import WeakDirection
from pretouch.geometry import Array
from pretouch.rotational_symmetry import find_symmetry_axis

FREE_STD = 0.003
"""m: a direction with a larger standard deviation is called free."""
MATTERS = 0.001
"""m, root mean square: a standard deviation that moves the points of a tolerance by more matters for them."""
_MIN_SHARE = 0.35
"""Least norm of the rotation, or of the translation, in a unit direction for it to be mentioned."""
_MIN_PARALLEL_COSINE = float(np.cos(np.radians(15.0)))
"""Cosine of the largest angle between an axis and the named one that it is described by."""
_MAX_PERPENDICULAR_COSINE = float(np.sin(np.radians(15.0)))
_MIN_ELONGATION = 1.5
"""Least ratio of the two largest standard deviations of a cloud that has a long axis."""
_MAX_EQUAL_RATIO = 1.1
"""Successive standard deviations up to this ratio count as equal."""
_VARIMAX_ROUNDS = 30
_MAX_POINTS = 5000
_BASE = dict(zip("xyz", np.eye(3), strict=True))


def find_weak_directions(
    covariance: Array, cloud: Array, up: Array, at: Array | None = None
) -> tuple[WeakDirection, ...]:
    """The axes of `covariance` (6, 6) with a standard deviation above FREE_STD, the weakest first.

    Rotations are scaled by the object's radius, so that both halves are metres.

    Args:
        cloud: (n, 3), m, the object's points as corrected, in base.
        up: (3,), the table's normal.
        at: (k, 3), m, in base, as corrected: where the error counts; the text then says how far a direction moves them.
            None: everywhere on the object.
    """
    arms = cloud - cloud.mean(axis=0)
    radius = float(np.sqrt((arms**2).sum(axis=1).mean()))
    scale = np.array([radius] * 3 + [1.0] * 3)
    scaled = covariance * np.outer(scale, scale)
    directions = _align_to_base(*np.linalg.eigh(scaled))
    stds = np.sqrt(np.maximum(np.einsum("ik,ij,jk->k", directions, scaled, directions), 0.0))
    named = _NamedAxes(cloud, up)
    found = []
    for k in np.argsort(-stds, kind="stable"):
        if stds[k] <= FREE_STD:
            break
        text = _describe(directions[:, k], float(stds[k]), radius, named)
        if at is None:
            found.append(WeakDirection(directions[:, k], float(stds[k]), text))
            continue
        moved = _measure_motion(stds[k] * directions[:, k] / scale, at - cloud.mean(axis=0))
        text += f"; it moves the points where the error counts by {1000 * moved:.1f} mm"
        found.append(WeakDirection(directions[:, k], float(stds[k]), text, moved > MATTERS))
    return tuple(found)


def _measure_motion(x: Array, arms: Array) -> float:
    """m: root mean square displacement of points at `arms` (k, 3), m, by a small correction x (6,), rad and m."""
    moved = np.cross(x[:3], arms) + x[3:]
    return float(np.sqrt((moved**2).sum(axis=1).mean()))


def _align_to_base(values: Array, vectors: Array) -> Array:
    """The principal axes (6, 6), by column, aligned with the axes of base as far as they are not unique.

    Axes of about the same standard deviation may be rotated among themselves; varimax (Kaiser 1958) finds the rotation
    that makes most of their components zero.
    """
    stds = np.sqrt(np.maximum(values, 0.0))
    starts = [0, *(np.flatnonzero(stds[1:] > _MAX_EQUAL_RATIO * stds[:-1]) + 1), 6]
    turned = vectors.copy()
    for start, end in pairwise(starts):
        group = vectors[:, start:end]
        turn = np.eye(end - start)
        for _ in range(_VARIMAX_ROUNDS):
            loads = group @ turn
            left, _, right = np.linalg.svd(group.T @ (loads**3 - loads * (loads**2).mean(axis=0)))
            turn = left @ right
        turned[:, start:end] = group @ turn
    largest = np.abs(turned).argmax(axis=0)
    return np.asarray(turned * np.sign(turned[largest, np.arange(6)]), dtype=np.float64)


def _describe(direction: Array, std: float, radius: float, axes: _NamedAxes) -> str:
    turn, shift = direction[:3], direction[3:]
    size = float(np.linalg.norm(turn))
    if size < _MIN_SHARE:
        return f"{axes.describe_shift(shift)} (±{1000 * std * np.linalg.norm(shift):.1f} mm)"
    axis = turn / size
    degrees = np.degrees(std * size / radius)
    middle_to_axis = radius * np.cross(axis, shift) / size
    text = f"{axes.describe_turn(axis, middle_to_axis, radius)} (±{degrees:.1f} deg)"
    pitch = float(axis @ shift)
    if abs(pitch) > _MIN_SHARE:
        text += f" with {axes.describe_shift(axis * pitch)} (±{1000 * std * abs(pitch):.1f} mm)"
    return text


class _NamedAxes:
    """The axes that have a name: the vertical, the object's long axis, those of base."""

    def __init__(self, cloud: Array, up: Array) -> None:
        self._cloud = cloud[:: -(-len(cloud) // _MAX_POINTS)]
        self._middle = cloud.mean(axis=0)
        self._up = up
        values, vectors = np.linalg.eigh(np.cov(cloud.T))
        spread = np.sqrt(np.maximum(values, 0.0))
        self._long = vectors[:, 2] if spread[2] > _MIN_ELONGATION * spread[1] else None

    def describe_shift(self, shift: Array) -> str:
        """A translation (3,) of any length, in words."""
        axis = shift / np.linalg.norm(shift)
        if abs(axis @ self._up) > _MIN_PARALLEL_COSINE:
            return "height above the table"
        return f"sliding along {self._name_axis(axis)}"

    def describe_turn(self, axis: Array, middle_to_axis: Array, radius: float) -> str:
        """A rotation about the unit vector `axis` (3,) at `middle_to_axis` (3,), m, from the cloud's mean, in words."""
        steepness = abs(axis @ self._up)
        name = "the vertical" if steepness > _MIN_PARALLEL_COSINE else self._name_axis(axis)
        tilts = steepness < _MAX_PERPENDICULAR_COSINE and not name.startswith("the object")
        text = f"{'tilt' if tilts else 'rotation'} about {name}"
        if find_symmetry_axis(self._cloud, axis) is not None:
            return f"{text} through the object, about which it looks round"
        away = float(np.linalg.norm(middle_to_axis))
        if away > radius:
            point = self._middle + middle_to_axis
            return f"{text} through {_format_vector(point)} m, {1000 * away:.0f} mm from the object's middle"
        return f"{text} through the object"

    def _name_axis(self, axis: Array) -> str:
        if self._long is not None and abs(axis @ self._long) > _MIN_PARALLEL_COSINE:
            return f"the object's long axis, base {_format_vector(_make_largest_positive(axis))}"
        for name, base in _BASE.items():
            if abs(axis @ base) > _MIN_PARALLEL_COSINE:
                return f"base {name}"
        return f"base {_format_vector(_make_largest_positive(axis))}"


def _make_largest_positive(axis: Array) -> Array:
    """The same axis with its largest component positive."""
    return axis * np.sign(axis[np.argmax(np.abs(axis))])


def _format_vector(vector: Array) -> str:
    return "(" + ", ".join(f"{value + 0.0:.2f}" for value in vector.round(2)) + ")"
