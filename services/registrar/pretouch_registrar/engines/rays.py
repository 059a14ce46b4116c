"""The rays that stand for a wide beam's cone."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pretouch.geometry import Array

_RINGS = ((0.0, 1), (0.5, 4), (0.85, 5))
"""Radius, as a share of the half angle, and rays of each ring."""
_EDGES = (0.0, 0.25, 0.69, 1.0)
"""Between them each ring's share of the cone lies, in the same unit."""


class Rays(NamedTuple):
    """k rays about a beam's axis; k = 0 for a thin beam.

    Attributes:
        across_x, across_y: (k,) lateral offsets at unit depth.
        length: (k,) path there.
        response: (k,) weight on a perpendicular wall, times the squared length.
    """

    across_x: Array
    across_y: Array
    length: Array
    response: Array


def no_rays() -> Rays:
    """Of a thin beam."""
    return Rays(*np.zeros((4, 0)))


def rays_of(half_angle: float) -> Rays:
    """The rays of a cone of this half angle, rad, with the response of a Gaussian that is a half at the cone's edge."""
    rows = []
    for n, (radius, count) in enumerate(_RINGS):
        angle = radius * half_angle
        turns = 2 * np.pi * (np.arange(count) + 0.5 * (n % 2)) / count
        area = (_EDGES[n + 1] ** 2 - _EDGES[n] ** 2) / count
        for turn in turns:
            tangent = np.tan(angle)
            response = area * np.exp(-np.log(2.0) * radius**2)
            rows.append([tangent * np.cos(turn), tangent * np.sin(turn), 1 / np.cos(angle), response])
    return Rays(*np.ascontiguousarray(np.array(rows).T))
