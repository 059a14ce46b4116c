"""Where a surface ends in front of another one, after Steder et al., "Point Feature Extraction on 3D Range Scans Taking
into Account Object Boundaries", ICRA 2011, section III.

A pixel is an obstacle border towards a side if the next pixels there are much further away than the points of its own
surface are from each other, and among those pixels is a shadow border, which sees the same jump from behind. Veil
points lie between the two.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch_detector.proposals.narf.range_image import Floats, RangeImage
from pretouch_detector.proposals.narf.surface import Surface

SIDES = ((-1, 0), (1, 0), (0, -1), (0, 1))
"""(du, dv) of left, right, top and bottom: the order of all arrays by side; `side ^ 1` is the opposite one."""
MIN_PROBABILITY = np.float32(0.8)
REACH = 3
"""px: pixels averaged towards a side, and how far away a shadow border is looked for."""
_STEPS = np.array(SIDES, dtype=np.int64)
_BONUS = np.float32(0.5)
_LEAST_KEPT = np.float32(0.9)
_ZERO, _ONE = np.float32(0), np.float32(1)


class Borders(NamedTuple):
    """The borders of a range image.

    Attributes:
        first_scores: (4, h, w) in (-1, 1) by side: how much further (positive) or nearer the next pixels are.
        scores: the same, after support by neighbouring pixels, and 0 for a border without a shadow.
        obstacle: (4, h, w) whether the pixel is an obstacle border towards the side.
        shadow, veil: (h, w) whether the pixel is a shadow border, a veil point.
    """

    first_scores: Floats
    scores: Floats
    obstacle: NDArray[np.bool_]
    shadow: NDArray[np.bool_]
    veil: NDArray[np.bool_]


def find_borders(image: RangeImage, surface: Surface) -> Borders:
    """Scores and classes of all pixels."""
    first = np.zeros((4, *image.ranges.shape), np.float32)
    _score_steps(image.points, image.ranges, surface.reach, first)
    scores = np.empty_like(first)
    for side in range(4):
        _support_scores(first[side], scores[side])
    partners = np.full(first.shape, -1, np.int64)
    for side in range(4):
        _find_shadows(scores[side], scores[side ^ 1].copy(), SIDES[side][0], SIDES[side][1], partners[side])
    found = Borders(
        first,
        scores,
        np.zeros(first.shape, np.bool_),
        np.zeros(image.ranges.shape, np.bool_),
        np.zeros(image.ranges.shape, np.bool_),
    )
    for side in range(4):
        du, dv = SIDES[side]
        _classify(scores[side], partners[side], du, dv, found.obstacle[side], found.shadow, found.veil)
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _score_steps(points: Floats, ranges: Floats, reach: Floats, scores: Floats) -> None:
    h, w = ranges.shape
    for v in range(h):
        for u in range(w):
            if np.isfinite(reach[v, u]):
                for side in range(4):
                    scores[side, v, u] = score_step(
                        points, ranges, reach[v, u], v, u, _STEPS[side, 0], _STEPS[side, 1], REACH
                    )


@njit(cache=True, nogil=True, error_model="numpy")
def score_step(
    points: Floats, ranges: Floats, reach: np.float32, v: int, u: int, du: int, dv: int, count: int
) -> np.float32:
    """In (-1, 1): how far the mean of `count` pixels next to (v, u), in steps of (du, dv), jumps back; 0: not at all.

    `reach`, m^2, is what is usual on the pixel's own surface. Below 0 they are nearer to the camera.
    """
    h, w = ranges.shape
    x, y, z, distance, weight = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
    for step in range(1, count + 1):
        j, i = v + step * dv, u + step * du
        if j < 0 or j >= h or i < 0 or i >= w or not np.isfinite(ranges[j, i]):
            continue
        x += points[j, i, 0]
        y += points[j, i, 1]
        z += points[j, i, 2]
        distance += ranges[j, i]
        weight += _ONE
    if weight == _ZERO:
        return _ZERO
    share = _ONE / weight
    dx = points[v, u, 0] - x * share
    dy = points[v, u, 1] - y * share
    dz = points[v, u, 2] - z * share
    square = dx * dx + dy * dy + dz * dz
    if square <= reach:
        return _ZERO
    score = _ONE - np.sqrt(reach / square)
    return -score if distance * share < ranges[v, u] else score


@njit(cache=True, nogil=True, error_model="numpy")
def _support_scores(scores: Floats, out: Floats) -> None:
    """Raises the scores that the eight neighbours' mean can bring above the least probability."""
    h, w = scores.shape
    for v in range(h):
        for u in range(w):
            score = scores[v, u]
            out[v, u] = score
            if score + _BONUS * (_ONE - score) < MIN_PROBABILITY:
                continue
            total, count = _ZERO, _ZERO
            for j in range(max(0, v - 1), min(h, v + 2)):
                for i in range(max(0, u - 1), min(w, u + 2)):
                    if i != u or j != v:
                        total += scores[j, i]
                        count += _ONE
            mean = total / count
            if mean * score >= _ZERO:
                out[v, u] = score + _BONUS * mean * (_ONE - abs(score))


@njit(cache=True, nogil=True, error_model="numpy")
def _find_shadows(scores: Floats, opposite: Floats, du: int, dv: int, partners: NDArray[np.int64]) -> None:
    """Finds each probable border's shadow border, the most negative score towards the opposite side; 0 without one.

    `partners` (h, w) becomes its distance, px, or -1.
    """
    h, w = scores.shape
    for v in range(h):
        for u in range(w):
            if scores[v, u] < MIN_PROBABILITY:
                continue
            partner, lowest = -1, _ZERO
            for step in range(1, REACH + 1):
                j, i = v + step * dv, u + step * du
                if 0 <= j < h and 0 <= i < w and opposite[j, i] < lowest:
                    partner, lowest = step, opposite[j, i]
            if partner > 0:
                rest = np.float64(_ONE + lowest)
                scores[v, u] *= max(_LEAST_KEPT, _ONE - np.float32(rest * rest * rest))
                if scores[v, u] >= MIN_PROBABILITY:
                    partners[v, u] = partner
                    continue
            scores[v, u] = _ZERO


@njit(cache=True, nogil=True, error_model="numpy")
def _classify(
    scores: Floats, partners: NDArray[np.int64], du: int, dv: int, obstacle: NDArray[np.bool_],
    shadow: NDArray[np.bool_], veil: NDArray[np.bool_],
) -> None:  # fmt: skip
    """Of neighbouring candidates only the best is the border; its shadow and what lies between are marked with it."""
    h, w = scores.shape
    for v in range(h):
        for u in range(w):
            partner = partners[v, u]
            if partner < 0:
                continue
            best = True
            for step in range(-1, partner):
                j, i = v + step * dv, u + step * du
                if 0 <= j < h and 0 <= i < w and scores[j, i] > scores[v, u]:
                    best = False
            if not best:
                continue
            obstacle[v, u] = True
            shadow[v + partner * dv, u + partner * du] = True
            for step in range(1, partner):
                veil[v + step * dv, u + step * du] = True
