"""Point-to-point ICP with or without trimming, compiled.

After Besl and McKay (PAMI 1992): nearest neighbours, best motion in closed form, again until nothing moves. With
trimming, after Phillips, Liu and Tomasi, "Outlier Robust ICP for Minimizing Fractional RMSD" (3DIM 2007): each round
keeps the k closest pairs for which FRMSD = sqrt(sum of the k smallest squared distances / k) / (k / n)^lambda is least.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch_registrar.engines.neighbours import Index, find, no_pairs
from pretouch_registrar.engines.rigid import fit, move

MAX_DISTANCE = 0.05
"""m: pairs further apart are not considered."""
LAMBDA = 0.95
MIN_PAIRS = 6
MAX_ROUNDS = 50
_SETTLED = 1e-8
"""m: change of FRMSD at which trimmed ICP ends."""
_STILL = 1e-5
"""m: plain ICP ends when no kept pair's point moves further in a round."""
_SORTING_STEPS = 8
"""Steps an entry at which keeping last round's order is given up and the order made anew."""


@njit(cache=True, nogil=True)
def align(source: Array, index: Index, trimmed: bool, r: Array, t: Array) -> int:
    """Fills r (3, 3), t (3,) with the motion of `source` (n, 3) onto the target of `index`, m: target = r source + t.

    Returns the pairs that the last round kept; 0, with r and t as they were last, once fewer than MIN_PAIRS are within
    MAX_DISTANCE.
    """
    n = source.shape[0]
    pairs = no_pairs(n)
    moved = source.copy()
    kept, kept_before = np.empty(n, np.bool_), np.zeros(n, np.bool_)
    neighbour_before = np.full(n, -1, np.int32)
    order = np.arange(n)
    weight = np.empty(n)
    for k in range(n):
        weight[k] = (k + 1.0) ** (-1.0 - 2.0 * LAMBDA)
    turn, shift = np.eye(3), np.zeros(3)
    r[:], t[:] = turn, shift
    previous = np.inf
    count = 0
    for _ in range(MAX_ROUNDS):
        find(moved, index, MAX_DISTANCE, pairs)
        count = 0
        for i in range(n):
            kept[i] = pairs.neighbour[i] >= 0
            count += kept[i]
        if count < MIN_PAIRS:
            return 0
        if trimmed:
            _sort(order, pairs.distance)
            paired = count
            count, least = _least_frmsd(order, pairs.distance, weight, paired)
            for k in range(count, paired):
                kept[order[k]] = False
        if _same(pairs.neighbour, neighbour_before, kept, kept_before):
            break
        fit(moved, index.points, pairs.neighbour, kept, turn, shift)
        compose(turn, shift, r, t)
        move(r, t, source, moved)
        if trimmed:
            if abs(previous - least) < _SETTLED:
                break
            previous = least
        elif _largest_step(turn, shift, moved) < _STILL:
            break
    return count


@njit(cache=True, nogil=True)
def _same(
    neighbour: NDArray[np.int32], neighbour_before: NDArray[np.int32], kept: NDArray[np.bool_],
    kept_before: NDArray[np.bool_],
) -> bool:  # fmt: skip
    """Whether all kept pairs are those of the round before, so that nothing would move any more; notes them if not."""
    same = True
    for i in range(kept.shape[0]):
        if kept[i] != kept_before[i] or (kept[i] and neighbour[i] != neighbour_before[i]):
            same = False
            neighbour_before[i], kept_before[i] = neighbour[i], kept[i]
    return same


@njit(cache=True, nogil=True)
def compose(turn: Array, shift: Array, r: Array, t: Array) -> None:
    """Appends a motion to (r, t): p -> turn (r p + t) + shift."""
    for k in range(3):
        r0, r1, r2 = r[0, k], r[1, k], r[2, k]
        for j in range(3):
            r[j, k] = turn[j, 0] * r0 + turn[j, 1] * r1 + turn[j, 2] * r2
    t0, t1, t2 = t[0], t[1], t[2]
    for j in range(3):
        t[j] = turn[j, 0] * t0 + turn[j, 1] * t1 + turn[j, 2] * t2 + shift[j]


@njit(cache=True, nogil=True)
def _largest_step(turn: Array, shift: Array, moved: Array) -> float:
    """m: how far the motion at most carries one of the points (n, 3) that it has led to."""
    most = 0.0
    for i in range(moved.shape[0]):
        step = 0.0
        for k in range(3):
            y0, y1, y2 = moved[i, 0] - shift[0], moved[i, 1] - shift[1], moved[i, 2] - shift[2]
            step += (moved[i, k] - turn[0, k] * y0 - turn[1, k] * y1 - turn[2, k] * y2) ** 2
        most = max(most, step)
    return np.sqrt(most)


@njit(cache=True, nogil=True)
def _least_frmsd(order: NDArray[np.int64], distance: Array, weight: Array, paired: int) -> tuple[int, float]:
    """How many of the `paired` closest pairs have the least FRMSD, and that FRMSD, m.

    weight (n,): (k + 1)^(-1 - 2 lambda).
    """
    total = 0.0
    best, count = np.inf, paired
    for k in range(paired):
        d = distance[order[k]]
        total += d * d
        if k + 1 >= MIN_PAIRS and total * weight[k] < best:
            best, count = total * weight[k], k + 1
    return count, np.sqrt(best) * paired**LAMBDA


@njit(cache=True, nogil=True)
def _sort(order: NDArray[np.int64], distance: Array) -> None:
    """Sorts `order` (n,), a permutation, by distance (n,); quick where the last round's order nearly holds."""
    budget = _SORTING_STEPS * order.shape[0]
    for k in range(1, order.shape[0]):
        i = order[k]
        d = distance[i]
        at = k
        while at > 0 and distance[order[at - 1]] > d:
            order[at] = order[at - 1]
            at -= 1
        order[at] = i
        budget -= k - at
        if budget < 0:
            order[:] = np.argsort(distance)
            return
