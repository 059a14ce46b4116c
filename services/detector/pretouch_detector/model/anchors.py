"""The region proposal network's anchors, and how a rectangle is told relative to another one.

All in normalised units: the image is [-1, 1] in both axes, x to the right, y down.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pretouch.geometry import Array

CELLS = 16
"""Cells of the anchors' grid, in each direction."""
SCALES = (0.44, 0.62, 0.88)
"""Square roots of the anchors' areas: candidates of 10-50 % of an object that fills most of the image."""
LONG = 2.0
"""Sides' ratio of the anchors that are no squares."""
TURNS = (-np.pi / 2, -np.pi / 4, 0.0, np.pi / 4)
"""Directions of those; a square one stands straight, since turned by 45 degrees it would overlap by 0.71 still."""
SHAPES = len(SCALES) * (1 + len(TURNS))
"""Anchors of a cell."""
_GROWTH = float(np.log(4.0))
"""A decoded side is at most 4 times, or a quarter of, what it started from."""


def anchors() -> Array:
    """(CELLS * CELLS * SHAPES, 5) rectangles: rows of cells from the top, cells from the left, shapes."""
    ratio = np.sqrt(LONG)
    shapes = np.array(
        [
            shape
            for scale in SCALES
            for shape in [(scale, scale, 0.0), *((scale * ratio, scale / ratio, turn) for turn in TURNS)]
        ]
    )
    centres = (2 * np.arange(CELLS) + 1) / CELLS - 1
    return np.array([(x, y, *shape) for y, x in itertools.product(centres, centres) for shape in shapes])


def encode(origins: NDArray[Any], rectangles: NDArray[Any]) -> Array:
    """What `decode` turns back: from each origin, (n, 5), to its rectangle, (n, 5).

    Of the two ways to tell a rectangle, [.., w, h, theta] and [.., h, w, theta + pi/2], it takes the one that turns
    the origin by at most 45 degrees.

    Returns:
        (n, 6): shift along the origin's sides, in sides; logarithms of the sides' ratios; cosine and sine of twice the
        turn, since half a turn changes no rectangle.
    """
    origin, goal = origins.astype(np.float64), rectangles.astype(np.float64)
    turn = (goal[:, 4] - origin[:, 4] + np.pi / 2) % np.pi - np.pi / 2
    across = np.abs(turn) > np.pi / 4
    turn = np.where(across, turn - np.copysign(np.pi / 2, turn), turn)
    sides = np.where(across[:, None], goal[:, [3, 2]], goal[:, 2:4])
    c, s = np.cos(origin[:, 4]), np.sin(origin[:, 4])
    u, v = (goal[:, :2] - origin[:, :2]).T
    shift = np.stack([c * u + s * v, c * v - s * u], axis=1) / origin[:, 2:4]
    return np.column_stack([shift, np.log(sides / origin[:, 2:4]), np.cos(2 * turn), np.sin(2 * turn)])


def decode(origins: NDArray[Any], deltas: NDArray[Any]) -> Array:
    """Rectangles (n, 5), theta in [-pi/2, pi/2), from origins (n, 5) and deltas (n, 6) as `encode` makes them."""
    origin, delta = origins.astype(np.float64), deltas.astype(np.float64)
    c, s = np.cos(origin[:, 4]), np.sin(origin[:, 4])
    along, across = (delta[:, :2] * origin[:, 2:4]).T
    sides = origin[:, 2:4] * np.exp(np.clip(delta[:, 2:4], -_GROWTH, _GROWTH))
    theta = origin[:, 4] + np.arctan2(delta[:, 5], delta[:, 4]) / 2
    theta = (theta + np.pi / 2) % np.pi - np.pi / 2
    return np.column_stack([origin[:, 0] + c * along - s * across, origin[:, 1] + s * along + c * across, sides, theta])


def quarter_turned(rectangles: NDArray[Any], turned: NDArray[np.bool_]) -> Array:
    """The same rectangles, those chosen by `turned` (n,) told the other way: sides swapped, theta a quarter turn on."""
    other = rectangles[:, [0, 1, 3, 2, 4]] + np.array([0.0, 0.0, 0.0, 0.0, np.pi / 2])
    other[:, 4] = (other[:, 4] + np.pi / 2) % np.pi - np.pi / 2
    return np.where(turned[:, None], other, rectangles)
