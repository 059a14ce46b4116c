"""Score and direction of the surface change at a pixel: across a border, elsewhere along the largest curvature."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch_detector.proposals.narf.borders import MIN_PROBABILITY, Borders, score_step
from pretouch_detector.proposals.narf.moments import COUNT, MOMENTS, add_point, compute_axes, dot, normalise
from pretouch_detector.proposals.narf.range_image import Floats, RangeImage
from pretouch_detector.proposals.narf.surface import Surface

_BORDER_RADIUS = 2
"""px: borders around whose directions are averaged."""
_BEND_RADIUS = 2
"""px: how far along eight rays the surrounding normals are compared with the pixel's own."""
_WIDEST_TURN = np.cos(np.float32(120.0) * np.float32(0.017453293), dtype=np.float32)
_SAME_SURFACE = np.float32(0.95) * MIN_PROBABILITY
_ZERO, _ONE = np.float32(0), np.float32(1)


class Change(NamedTuple):
    """Surface change.

    Attributes:
        scores: (h, w) in [0, 1]; 1 on a border, 0 where nothing is known.
        directions: (h, w, 3) unit, camera frame, away from the obstacle on a border; zero where nothing is known.
    """

    scores: Floats
    directions: Floats


def measure_change(image: RangeImage, surface: Surface, borders: Borders) -> Change:
    """The change at each pixel that is neither shadow border nor veil point."""
    hidden = borders.shadow | borders.veil
    shape = image.ranges.shape
    single = np.full((*shape, 3), np.nan, np.float32)
    _compute_border_directions(
        image.points,
        image.ranges,
        image.optics,
        surface.normals,
        surface.means,
        surface.reach,
        borders.obstacle,
        single,
    )
    found = Change(np.zeros(shape, np.float32), np.zeros((*shape, 3), np.float32))
    _average_directions(image.points, image.ranges, surface.reach, single, hidden, found.scores, found.directions)
    _score_bends(image.ranges, surface.normals, surface.reach, hidden, found.scores, found.directions)
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _compute_border_directions(
    points: Floats, ranges: Floats, optics: Floats, normals: Floats, means: Floats, reach: Floats,
    obstacle: NDArray[np.bool_], directions: Floats,
) -> None:  # fmt: skip
    """On the pixel's plane, towards the next pixel of the sides on which it is a border; NaN stays elsewhere."""
    h, w = ranges.shape
    ray = np.empty(3, np.float32)
    for v in range(h):
        for u in range(w):
            du = np.int64(obstacle[1, v, u]) - np.int64(obstacle[0, v, u])
            dv = np.int64(obstacle[3, v, u]) - np.int64(obstacle[2, v, u])
            if du == 0 and dv == 0:
                continue
            x = (np.float32(u + du) - optics[2]) * optics[0]
            y = (np.float32(v + dv) - optics[3]) * optics[1]
            z = ranges[v, u] / np.sqrt(x * x + y * y + _ONE)
            ray[0], ray[1], ray[2] = x * z, y * z, z
            factor = dot(normals[v, u], means[v, u]) / dot(normals[v, u], ray)
            for k in range(3):
                directions[v, u, k] = factor * ray[k] - points[v, u, k]
            normalise(directions[v, u])


@njit(cache=True, nogil=True, error_model="numpy")
def _average_directions(
    points: Floats, ranges: Floats, reach: Floats, single: Floats, hidden: NDArray[np.bool_], scores: Floats,
    directions: Floats,
) -> None:  # fmt: skip
    """Averages the directions of at least three borders of one surface that do not face each other."""
    h, w = ranges.shape
    for v in range(h):
        for u in range(w):
            if hidden[v, u] or np.isnan(single[v, u, 0]):
                continue
            total, count = single[v, u].copy(), 1
            for j in range(max(0, v - _BORDER_RADIUS), min(h, v + _BORDER_RADIUS + 1)):
                for i in range(max(0, u - _BORDER_RADIUS), min(w, u + _BORDER_RADIUS + 1)):
                    if (i == u and j == v) or np.isnan(single[j, i, 0]):
                        continue
                    if dot(single[j, i], single[v, u]) < _WIDEST_TURN:
                        continue
                    score = score_step(points, ranges, reach[v, u], v, u, i - u, j - v, 1)
                    if abs(score) < _SAME_SURFACE:
                        total += single[j, i]
                        count += 1
            if count > _BORDER_RADIUS:
                normalise(total)
                directions[v, u] = total
                scores[v, u] = _ONE


@njit(cache=True, nogil=True, error_model="numpy")
def _score_bends(
    ranges: Floats, normals: Floats, reach: Floats, hidden: NDArray[np.bool_], scores: Floats, directions: Floats
) -> None:
    """Where there is no border: how far the normals around spread, and along which axis."""
    h, w = reach.shape
    moments = np.empty(MOMENTS, np.float32)
    values, vectors = np.empty(3, np.float32), np.empty((3, 3), np.float32)
    blocked = np.empty((3, 3), np.bool_)
    for v in range(h):
        for u in range(w):
            if scores[v, u] > _ZERO or hidden[v, u] or np.isnan(reach[v, u]):
                continue
            moments[:] = _ZERO
            blocked[:] = False
            for step in range(1, _BEND_RADIUS + 1):
                for dv in range(-1, 2):
                    for du in range(-1, 2):
                        j, i = v + step * dv, u + step * du
                        if (step > 1 and du == 0 and dv == 0) or j < 0 or j >= h or i < 0 or i >= w:
                            continue
                        if blocked[dv + 1, du + 1] or not np.isfinite(ranges[j, i]):
                            continue
                        if hidden[j, i]:
                            blocked[dv + 1, du + 1] = True
                        elif np.isfinite(reach[j, i]):
                            add_point(moments, normals[j, i], _ONE)
            if moments[COUNT] < 3:
                continue
            compute_axes(moments, values, vectors)
            spread = np.sqrt(values[2])
            if np.isfinite(spread):
                scores[v, u] = spread
                directions[v, u] = vectors[2]
