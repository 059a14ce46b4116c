"""Regions that differ: of two that overlap much only the better is kept."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch_detector.overlap import intersection

MAX_OVERLAP = 0.6
"""Intersection over union of regions that are proposed."""


def spread(ranked: Array, count: int, limit: float = MAX_OVERLAP) -> list[int]:
    """Which of the rectangles are kept: the best, then each that overlaps no better one too much.

    Args:
        ranked: (n, 5) as [x, y, w, h, theta], the best first.
        count: as many at most.
        limit: intersection over union, exact, above which it is too much.

    Returns:
        Their indices, the best first.
    """
    areas = ranked[:, 2] * ranked[:, 3]
    left = np.arange(len(ranked))
    kept: list[int] = []
    while len(left) and len(kept) < count:
        best, left = int(left[0]), left[1:]
        kept.append(best)
        near = np.flatnonzero(_may_share(ranked[best], ranked[left], limit * np.maximum(areas[best], areas[left])))
        common = intersection(ranked[left[near]], ranked[best])
        too_much = common / (areas[best] + areas[left[near]] - common) > limit
        left = np.delete(left, near[too_much])
    return kept


def _may_share(rectangle: Array, others: Array, area: Array) -> NDArray[np.bool_]:
    """Whether the rectangle may have `area` (n,) in common with each of the others (n, 5); cheap, never wrongly no."""
    x, y, w, h, theta = rectangle
    turn = others[:, 4] - theta
    c, s = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    half = np.stack([c * others[:, 2] + s * others[:, 3], s * others[:, 2] + c * others[:, 3]], axis=1) / 2
    du, dv = others[:, 0] - x, others[:, 1] - y
    centre = np.stack([np.cos(theta) * du + np.sin(theta) * dv, np.cos(theta) * dv - np.sin(theta) * du], axis=1)
    own = np.array([w, h]) / 2
    sides = np.clip(np.minimum(own, centre + half) - np.maximum(-own, centre - half), 0, None)
    return np.asarray(sides.prod(axis=1) >= area * (1 - 1e-9), dtype=np.bool_)
