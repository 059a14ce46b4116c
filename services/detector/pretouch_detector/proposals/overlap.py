"""The area that rotated rectangles have in common, exactly."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pretouch.geometry import Array

_RIGHT, _DOWN = np.array([-0.5, 0.5, 0.5, -0.5]), np.array([-0.5, -0.5, 0.5, 0.5])
"""The corners, in order along the outline, in units of the sides."""
_NEXT = np.array([1, 2, 3, 0])


def common_area(rectangle: ArrayLike, others: Array) -> Array:
    """(n,): area that the rectangle (5,) and each of the others (n, 5) have in common, all as [x, y, w, h, theta].

    In the rectangle's own axes it is a box. Each outline is brought into that box coordinate by coordinate: what was
    outside comes to lie on the box's sides and encloses nothing, so that the area inside the outline is the common one.
    """
    x, y, w, h, theta = np.asarray(rectangle, dtype=np.float64)
    dx, dy, c, s = others[:, 0] - x, others[:, 1] - y, np.cos(theta), np.sin(theta)
    turn = others[:, 4] - theta
    along, across = np.cos(turn), np.sin(turn)
    right, down = others[:, 2, None] * _RIGHT, others[:, 3, None] * _DOWN
    u = (c * dx + s * dy)[:, None] + along[:, None] * right - across[:, None] * down
    v = (c * dy - s * dx)[:, None] + across[:, None] * right + along[:, None] * down
    du, dv = u[:, _NEXT] - u, v[:, _NEXT] - v
    bends = np.zeros((len(others), 4, 5))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for k, (start, step, limit) in enumerate([(u, du, w / 2), (u, du, -w / 2), (v, dv, h / 2), (v, dv, -h / 2)]):
            np.divide(limit - start, step, out=bends[..., k + 1])
    bends[np.isnan(bends)] = 0.0
    np.clip(bends, 0.0, 1.0, out=bends)
    bends.sort(axis=-1)
    u = (u[..., None] + bends * du[..., None]).clip(-w / 2, w / 2).reshape(len(others), 20)
    v = (v[..., None] + bends * dv[..., None]).clip(-h / 2, h / 2).reshape(len(others), 20)
    doubled = (u[:, :-1] * v[:, 1:] - v[:, :-1] * u[:, 1:]).sum(axis=1) + u[:, -1] * v[:, 0] - v[:, -1] * u[:, 0]
    return np.asarray(0.5 * doubled.clip(0.0), dtype=np.float64)
