"""The paths of beams along rectangles' perimeters, over the ground: a compiled part of `information`."""

from __future__ import annotations

import numpy as np
from numba import njit

from pretouch.geometry import Array
from pretouch_detector.proposals.from_above import Grid

_STEPS = 120
"""Pixels that are sampled evenly along a perimeter."""


@njit(cache=True, nogil=True)
def trace_perimeters(
    rectangles: Array,
    places: Array,
    first: tuple[int, int],
    step: int,
    away: Array,
    grid: Grid,
    reach: float,
    beams: int,
) -> tuple[Array, Array]:
    """Places (n, beams, 2), m, evenly along each perimeter, and the paths' lengths (n,), m.

    Stretches that show neither object nor table, or lie further than `reach`, m, from the object, are crossed straight.
    A perimeter that never comes near has length 0.

    Args:
        rectangles: (n, 5) as [x, y, w, h, theta], px and rad.
        places, first, step, away, grid: as in `Relief`.
    """
    count = len(rectangles)
    along, lengths = np.zeros((count, beams, 2)), np.zeros(count)
    met, travelled = np.empty((_STEPS, 2)), np.empty(_STEPS)
    rows, columns = places.shape[:2]
    corner, cell, (nx, ny) = grid
    for n in range(count):
        x, y, w, h, theta = rectangles[n]
        cosine, sine = np.cos(theta), np.sin(theta)
        known = 0
        for k in range(_STEPS):
            s = k / _STEPS * 2.0 * (w + h)
            a = min(s, w) - min(max(s - w - h, 0.0), w) - w / 2
            b = min(max(s - w, 0.0), h) - min(max(s - 2.0 * w - h, 0.0), h) - h / 2
            u = int(np.rint((x + cosine * a - sine * b - first[0]) / step))
            v = int(np.rint((y + sine * a + cosine * b - first[1]) / step))
            if u < 0 or u >= columns or v < 0 or v >= rows or np.isnan(places[v, u, 0]):
                continue
            p, q = places[v, u, 0], places[v, u, 1]
            i = min(max(int(np.rint((p - corner[0]) / cell)), 0), nx - 1)
            j = min(max(int(np.rint((q - corner[1]) / cell)), 0), ny - 1)
            if away[i, j] > reach:
                continue
            met[known, 0], met[known, 1], travelled[known] = p, q, 0.0
            if known > 0:
                gone = (p - met[known - 1, 0]) ** 2 + (q - met[known - 1, 1]) ** 2
                travelled[known] = travelled[known - 1] + np.sqrt(gone)
            known += 1
        if known == 0:
            continue
        lengths[n] = travelled[known - 1]
        k = 0
        for i in range(beams):
            at = (i + 0.5) / beams * lengths[n]
            while k + 2 < known and travelled[k + 1] <= at:
                k += 1
            share = 0.0
            if known > 1 and travelled[k + 1] > travelled[k]:
                share = (at - travelled[k]) / (travelled[k + 1] - travelled[k])
            for axis in range(2):
                along[n, i, axis] = met[k, axis] + share * (met[min(k + 1, known - 1), axis] - met[k, axis])
    return along, lengths
