"""The area that rotated rectangles have in common, exactly, many at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pretouch.geometry import Array

_RIGHT, _DOWN = np.array([-0.5, 0.5, 0.5, -0.5]), np.array([-0.5, -0.5, 0.5, 0.5])
"""The corners, in order along the outline, in units of the sides."""
_NEXT = np.array([1, 2, 3, 0])
_FLAT = 1e-12
"""A length below which an edge's extent counts as this one; it bounds a wrong share by as much."""


def overlap(first: ArrayLike, second: ArrayLike) -> Array:
    """(n, m) in [0, 1]: intersection over union of (n, 5) and (m, 5) as [x, y, w, h, theta], all with all."""
    some, others = (np.asarray(each, dtype=np.float64) for each in (first, second))
    reach = _radius(some)[:, None] + _radius(others)
    near, far = np.nonzero(((some[:, None, :2] - others[:, :2]) ** 2).sum(axis=2) < reach**2)
    common = intersection(some[near], others[far])
    union = some[near, 2] * some[near, 3] + others[far, 2] * others[far, 3] - common
    found = np.zeros_like(reach)
    found[near, far] = common / union
    return found


def intersection(first: ArrayLike, second: ArrayLike) -> Array:
    """(...,): area that rectangles (..., 5) as [x, y, w, h, theta] have in common, pair by pair.

    The common area is the integral of an indicator, 1 in the second rectangle, over the first. By Green's theorem that
    is the integral of clamp(x, -W/2, W/2) + W/2 over dy along those parts of the first one's edges with |y| <= H/2, in
    the axes of the second, which is W wide and H high. Along an edge the integrand is piecewise linear, so the
    trapezoids between its bends are exact. Nothing depends on which corner is inside what, so that edges which coincide
    are no special case. It is at least 0 and at most the smaller of the two areas.
    """
    some, others = np.broadcast_arrays(np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64))
    x, y, w, h, theta = np.moveaxis(some, -1, 0)
    middle_x, middle_y, width, height, axis = np.moveaxis(others, -1, 0)
    c, s = np.cos(axis), np.sin(axis)
    u, v = x - middle_x, y - middle_y
    u, v = c * u + s * v, c * v - s * u
    c, s = np.cos(theta - axis), np.sin(theta - axis)
    right, down = np.multiply.outer(_RIGHT, w), np.multiply.outer(_DOWN, h)
    x0, y0 = u + c * right - s * down, v + s * right + c * down
    dx, dy = x0[_NEXT] - x0, y0[_NEXT] - y0
    safe_dx, safe_dy = (np.where(np.abs(d) < _FLAT, _FLAT, d) for d in (dx, dy))
    ends = np.array([(0.5 * height - y0) / safe_dy, (-0.5 * height - y0) / safe_dy]).clip(0.0, 1.0)
    enter, leave = ends.min(axis=0), ends.max(axis=0)
    sides = np.sort([(0.5 * width - x0) / safe_dx, (-0.5 * width - x0) / safe_dx], axis=0).clip(enter, leave)
    bends = np.stack([enter, *sides, leave])
    heights = (x0 + bends * dx + 0.5 * width).clip(0.0, width)
    area = 0.5 * (dy * np.diff(bends, axis=0) * (heights[1:] + heights[:-1])).sum(axis=(0, 1))
    return np.asarray(area.clip(0.0, np.minimum(w * h, width * height)), dtype=np.float64)


def _radius(rectangles: Array) -> Array:
    """(n,): half the diagonals."""
    return np.asarray(np.hypot(rectangles[:, 2], rectangles[:, 3]) / 2, dtype=np.float64)
