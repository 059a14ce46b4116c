"""The area that rotated rectangles have in common, exactly."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pretouch.geometry import Array

_CORNERS = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])


def common_area(rectangle: ArrayLike, others: Array) -> Array:
    """(n,): area that the rectangle (5,) and each of the others (n, 5) have in common, all as [x, y, w, h, theta].

    In the rectangle's own axes it is a box. Each outline is brought into that box coordinate by coordinate: what was
    outside comes to lie on the box's sides and encloses nothing, so that the area inside the outline is the common one.
    """
    x, y, w, h, theta = np.asarray(rectangle, dtype=np.float64)
    limit = np.array([w, h]) / 2
    offset, c, s = others[:, :2] - (x, y), np.cos(theta), np.sin(theta)
    centre = np.stack([c * offset[:, 0] + s * offset[:, 1], c * offset[:, 1] - s * offset[:, 0]], axis=1)
    c, s = np.cos(others[:, 4] - theta)[:, None], np.sin(others[:, 4] - theta)[:, None]
    a, b = np.moveaxis(_CORNERS * others[:, None, 2:4], -1, 0)
    corners = np.stack([c * a - s * b, s * a + c * b], axis=-1) + centre[:, None]
    sides = np.roll(corners, -1, axis=1) - corners
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        crossings = np.concatenate([(limit - corners) / sides, (-limit - corners) / sides], axis=-1)
    bends = np.sort(np.nan_to_num(crossings, nan=0.0).clip(0.0, 1.0), axis=-1)
    bends = np.concatenate([np.zeros_like(bends[..., :1]), bends], axis=-1)[..., None]
    outline = (corners[:, :, None] + bends * sides[:, :, None]).reshape(len(others), 20, 2).clip(-limit, limit)
    u, v = np.moveaxis(outline, -1, 0)
    doubled = (u * np.roll(v, -1, axis=1) - v * np.roll(u, -1, axis=1)).sum(axis=1)
    return np.asarray(0.5 * doubled.clip(0.0), dtype=np.float64)
