"""The directions in which a pose is still free, in words.

A direction of the pose is a screw: a turn about some axis with a shift along it. Which axis it is, and whether the
object looks round about it, is said as one would show it with a finger; deviations are in degrees for a turn and in
millimetres for a shift.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from pretouch.estimate import WeakDirection
from pretouch.geometry import Array
from pretouch_registrar.revolution import revolution_about

FREE_STD = 0.003
"""m: a direction with a larger standard deviation is called free."""
_COUNTS = 0.35
"""Share of a unit direction from which on its turn, or its shift, is worth a word."""
_ALONG = float(np.cos(np.radians(15.0)))
"""Cosine of the angle up to which an axis is called by the name of another."""
_ACROSS = float(np.sin(np.radians(15.0)))
_LONG = 1.5
"""Ratio of the cloud's standard deviations from which on an object has a long axis."""
_ALIKE = 1.1
"""Neighbouring deviations up to this ratio count as the same."""
_VARIMAX_ROUNDS = 30
_MOST_POINTS = 5000
_BASE = dict(zip("xyz", np.eye(3), strict=True))


def weak_directions(covariance: Array, cloud: Array, up: Array) -> tuple[WeakDirection, ...]:
    """The axes of `covariance` (6, 6) with a standard deviation above FREE_STD, the weakest first.

    Rotations are scaled by the object's radius, so that both halves are metres.

    Args:
        cloud: (n, 3), m, the object's points as corrected, in base.
        up: (3,), the table's normal.
    """
    arms = cloud - cloud.mean(axis=0)
    radius = float(np.sqrt((arms**2).sum(axis=1).mean()))
    scale = np.array([radius] * 3 + [1.0] * 3)
    scaled = covariance * np.outer(scale, scale)
    directions = _readable(*np.linalg.eigh(scaled))
    stds = np.sqrt(np.maximum(np.einsum("ik,ij,jk->k", directions, scaled, directions), 0.0))
    named = _Axes(cloud, up)
    return tuple(
        WeakDirection(directions[:, k], float(stds[k]), _words(directions[:, k], float(stds[k]), radius, named))
        for k in np.argsort(-stds, kind="stable")
        if stds[k] > FREE_STD
    )


def _readable(values: Array, vectors: Array) -> Array:
    """The principal axes (6, 6), by column, those of about the same deviation turned among themselves to few numbers.

    Any turn of such axes says the same; varimax (Kaiser 1958) finds the one nearest to the axes of base.
    """
    stds = np.sqrt(np.maximum(values, 0.0))
    starts = [0, *(np.flatnonzero(stds[1:] > _ALIKE * stds[:-1]) + 1), 6]
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


def _words(direction: Array, std: float, radius: float, axes: _Axes) -> str:
    turn, shift = direction[:3], direction[3:]
    size = float(np.linalg.norm(turn))
    if size < _COUNTS:
        return f"{axes.shift(shift)} (±{1000 * std * np.linalg.norm(shift):.1f} mm)"
    axis = turn / size
    degrees = np.degrees(std * size / radius)
    middle_to_axis = radius * np.cross(axis, shift) / size
    text = f"{axes.turn(axis, middle_to_axis, radius)} (±{degrees:.1f} deg)"
    pitch = float(axis @ shift)
    if abs(pitch) > _COUNTS:
        text += f" with {axes.shift(axis * pitch)} (±{1000 * std * abs(pitch):.1f} mm)"
    return text


class _Axes:
    """The axes that have a name: the vertical, the object's long one, those of base."""

    def __init__(self, cloud: Array, up: Array) -> None:
        self._cloud = cloud[:: -(-len(cloud) // _MOST_POINTS)]
        self._middle = cloud.mean(axis=0)
        self._up = up
        values, vectors = np.linalg.eigh(np.cov(cloud.T))
        spread = np.sqrt(np.maximum(values, 0.0))
        self._long = vectors[:, 2] if spread[2] > _LONG * spread[1] else None

    def shift(self, shift: Array) -> str:
        """A shift (3,) of any length, in words."""
        axis = shift / np.linalg.norm(shift)
        if abs(axis @ self._up) > _ALONG:
            return "height above the table"
        return f"sliding along {self._name(axis)}"

    def turn(self, axis: Array, middle_to_axis: Array, radius: float) -> str:
        """A turn about the unit vector `axis` (3,) at `middle_to_axis` (3,), m, from the cloud's mean, in words."""
        steepness = abs(axis @ self._up)
        name = "the vertical" if steepness > _ALONG else self._name(axis)
        tilts = steepness < _ACROSS and not name.startswith("the object")
        text = f"{'tilt' if tilts else 'rotation'} about {name}"
        if revolution_about(self._cloud, axis) is not None:
            return f"{text} through the object, about which it looks round"
        away = float(np.linalg.norm(middle_to_axis))
        if away > radius:
            point = self._middle + middle_to_axis
            return f"{text} through {_numbers(point)} m, {1000 * away:.0f} mm from the object's middle"
        return f"{text} through the object"

    def _name(self, axis: Array) -> str:
        if self._long is not None and abs(axis @ self._long) > _ALONG:
            return f"the object's long axis, base {_numbers(_signed(axis))}"
        for name, base in _BASE.items():
            if abs(axis @ base) > _ALONG:
                return f"base {name}"
        return f"base {_numbers(_signed(axis))}"


def _signed(axis: Array) -> Array:
    """The same axis, its largest number positive."""
    return axis * np.sign(axis[np.argmax(np.abs(axis))])


def _numbers(vector: Array) -> str:
    return "(" + ", ".join(f"{value + 0.0:.2f}" for value in vector.round(2)) + ")"
