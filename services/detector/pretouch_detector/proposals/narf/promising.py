"""An inexpensive test that excludes most pixels before their interest is computed.

The interest of a pixel counts only pixels connected to it, which takes a search to find. Counting all pixels within
reach instead gives an upper bound, for which only pixels where the surface changes, a small part, need to be visited.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch_detector.proposals.narf.change import Change
from pretouch_detector.proposals.narf.interest import (
    ALWAYS_PX,
    BINS,
    FULL_PX,
    LEAST_CHANGE,
    compare_bins,
    compute_image_axes,
    find_bin,
)
from pretouch_detector.proposals.narf.range_image import Floats, RangeImage

_ZERO, _ONE, _HALF = np.float32(0), np.float32(1), np.float32(0.5)
_ROUNDING = np.float32(1e-5)


class _Strong(NamedTuple):
    """The pixels where the surface changes, row by row.

    Attributes:
        columns: (n,), of each.
        before: (h, w + 1), at [v, u]: how many are in earlier rows, and in this one to the left of u.
        changes: (n, 7): each one's point, score and direction.
    """

    columns: NDArray[np.int32]
    before: NDArray[np.int32]
    changes: Floats


def find_promising(
    image: RangeImage, change: Change, hidden: NDArray[np.bool_], where: NDArray[np.bool_], support: float, least: float
) -> NDArray[np.bool_]:
    """(h, w): a superset of the pixels `where` (h, w) whose interest is at least `least`, with few others."""
    usable = np.isfinite(image.ranges) & ~hidden
    strong = usable & (change.scores >= LEAST_CHANGE)
    columns = np.nonzero(strong)[1].astype(np.int32)
    before = np.zeros((strong.shape[0], strong.shape[1] + 1), np.int32)
    before[:, 1:] = np.cumsum(strong, dtype=np.int32).reshape(strong.shape)
    before[1:, 0] = before[:-1, -1]
    changes = np.column_stack([image.points[strong], change.scores[strong], change.directions[strong]])
    found = np.zeros(strong.shape, np.bool_)
    _mark_promising(
        image.points,
        image.optics,
        _Strong(columns, before, changes),
        where & usable,
        np.float32(support),
        np.float32(least),
        found,
    )
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _mark_promising(
    points: Floats, optics: Floats, strong: _Strong, where: NDArray[np.bool_], support: np.float32, least: np.float32,
    found: NDArray[np.bool_],
) -> None:  # fmt: skip
    columns, before, changes = strong
    h, w = where.shape
    radius = _HALF * support
    square_radius, inverse_radius = radius * radius, _ONE / radius
    enough = least * least * (_ONE - _ROUNDING)
    bins, frame = np.empty(BINS, np.float32), np.empty(6, np.float32)
    for v in range(h):
        for u in range(w):
            if not where[v, u]:
                continue
            x, y, z = points[v, u, 0], points[v, u, 1], points[v, u, 2]
            compute_image_axes(x, y, z, frame)
            bins[:] = _ZERO
            du, dv = max(h, w), max(h, w)
            if z > radius:
                du = ALWAYS_PX + int(radius * np.sqrt(_ONE + x * x / (z * z)) / (z - radius) / optics[0]) + 1
                dv = ALWAYS_PX + int(radius * np.sqrt(_ONE + y * y / (z * z)) / (z - radius) / optics[1]) + 1
            for j in range(max(0, v - dv), min(h, v + dv + 1)):
                for n in range(before[j, max(0, u - du)], before[j, min(w, u + du + 1)]):
                    ex, ey, ez = changes[n, 0] - x, changes[n, 1] - y, changes[n, 2] - z
                    square = ex * ex + ey * ey + ez * ez
                    away = max(abs(j - v), abs(int(columns[n]) - u))
                    if square > square_radius and away > ALWAYS_PX:
                        continue
                    strength = changes[n, 3]
                    if away > FULL_PX:
                        strength *= _ONE - inverse_radius * np.sqrt(square)
                    if strength <= enough:  # the other one of a pair is at most 1
                        continue
                    cell = find_bin(changes[n, 4:7], frame)
                    if strength > bins[cell]:
                        bins[cell] = strength
                        for other in range(BINS):
                            if bins[cell] * bins[other] * compare_bins(abs(cell - other)) >= enough:
                                found[v, u] = True
                    if found[v, u]:
                        break
                if found[v, u]:
                    break
