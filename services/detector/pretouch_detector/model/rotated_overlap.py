"""Exact overlap of rotated rectangles, many at once, by the same formula for numpy arrays and torch tensors."""

from __future__ import annotations

import sys
from typing import Any

_FLAT = 1e-12
"""A length below which an edge's extent counts as this one; it bounds a wrong share by as much."""


def overlap(first: Any, second: Any) -> Any:
    """Intersection over union of rectangles, all with all.

    Args:
        first, second: (n, 5) and (m, 5) as [x, y, w, h, theta], both numpy arrays or both torch tensors, w and h > 0.

    Returns:
        (n, m) in [0, 1], of the same kind and precision.
    """
    offset = first[:, None, :2] - second[None, :, :2]
    reach = _radius(first)[:, None] + _radius(second)[None]
    near = (offset**2).sum(-1) < reach**2
    shape = (len(first), len(second), 5)
    library = _library(first)
    some = library.broadcast_to(first[:, None], shape)[near]
    others = library.broadcast_to(second[None], shape)[near]
    common = intersection(some, others)
    union = some[:, 2] * some[:, 3] + others[:, 2] * others[:, 3] - common
    found = library.zeros_like(reach)
    found[near] = common / union
    return found


def intersection(first: Any, second: Any) -> Any:
    """Area that rectangles have in common, pair by pair.

    The common area is the integral of an indicator, 1 in the second rectangle, over the first. By Green's theorem that
    is the integral of clamp(x, -W/2, W/2) + W/2 over dy along those parts of the first one's edges with |y| <= H/2, in
    the axes of the second, which is W wide and H high. Along an edge the integrand is piecewise linear, so the
    trapezoids between its bends are exact. Nothing depends on which corner is inside what, so that edges which coincide
    are no special case.

    Args:
        first, second: (n, 5) each.

    Returns:
        (n,), at least 0 and at most the smaller of the two areas.
    """
    library = _library(first)
    c, s = library.cos(second[:, 4]), library.sin(second[:, 4])
    u, v = first[:, 0] - second[:, 0], first[:, 1] - second[:, 1]
    x, y = c * u + s * v, c * v - s * u
    turn = first[:, 4] - second[:, 4]
    c, s = library.cos(turn) / 2, library.sin(turn) / 2
    along_x, along_y = c * first[:, 2], s * first[:, 2]
    across_x, across_y = -s * first[:, 3], c * first[:, 3]
    signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    corners = [(x + i * along_x + j * across_x, y + i * along_y + j * across_y) for i, j in signs]
    width, height = second[:, 2], second[:, 3]
    area = sum(_under(library, *corners[k], *corners[(k + 1) % 4], width, height) for k in range(4))
    smaller = library.minimum(first[:, 2] * first[:, 3], width * height)
    return library.minimum(library.clip(area, 0, None), smaller)


def _under(library: Any, x0: Any, y0: Any, x1: Any, y1: Any, width: Any, height: Any) -> Any:
    """The edge's share of the integral, (n,)."""
    dx, dy = x1 - x0, y1 - y0
    safe_dx = library.where(abs(dx) < _FLAT, _FLAT, dx)
    safe_dy = library.where(abs(dy) < _FLAT, _FLAT, dy)
    low, high = library.clip((-height / 2 - y0) / safe_dy, 0, 1), library.clip((height / 2 - y0) / safe_dy, 0, 1)
    enter, leave = library.minimum(low, high), library.maximum(low, high)
    left, right = (-width / 2 - x0) / safe_dx, (width / 2 - x0) / safe_dx
    bends = (
        enter,
        library.minimum(library.maximum(library.minimum(left, right), enter), leave),
        library.minimum(library.maximum(library.maximum(left, right), enter), leave),
        leave,
    )
    heights = [library.minimum(library.clip(x0 + t * dx + width / 2, 0, None), width) for t in bends]
    trapezoids = sum((bends[k + 1] - bends[k]) * (heights[k] + heights[k + 1]) for k in range(3))
    return dy * trapezoids / 2


def _radius(rectangles: Any) -> Any:
    """(n,): half the diagonals."""
    return (rectangles[:, 2] ** 2 + rectangles[:, 3] ** 2) ** 0.5 / 2


def _library(array: Any) -> Any:
    """numpy or torch, whichever the array is of; torch is not imported for an array of numpy's."""
    return sys.modules[type(array).__module__.partition(".")[0]]
