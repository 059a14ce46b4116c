"""Point-to-point ICP with or without trimming, compiled.

After Besl and McKay (PAMI 1992): nearest neighbours and the best rigid motion in closed form, until convergence. With
trimming, after Phillips, Liu and Tomasi, "Outlier Robust ICP for Minimizing Fractional RMSD" (3DIM 2007): each round
keeps the k closest correspondences, with k minimising
FRMSD = sqrt(sum of the k smallest squared distances / k) / (k / n)^lambda.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch_registrar.engines.neighbours import Index, find_neighbours, make_correspondences
from pretouch_registrar.engines.rigid import apply_motion, fit_rigid_motion

MAX_DISTANCE = 0.05
"""m: correspondences further apart are not considered."""
LAMBDA = 0.95
MIN_CORRESPONDENCES = 6
MAX_ROUNDS = 50
_MIN_FRMSD_CHANGE = 1e-8
"""m: change of FRMSD at which trimmed ICP ends."""
_MIN_STEP = 1e-5
"""m: plain ICP ends when no point moves further in a round."""
_MAX_SORTING_STEPS = 8
"""Steps per entry after which insertion sort, quick for a nearly sorted order, is given up for a full sort."""


@njit(cache=True, nogil=True)
def align(source: Array, index: Index, trimmed: bool, r: Array, t: Array) -> int:
    """Fills r (3, 3), t (3,) with the motion of `source` (n, 3) onto the target of `index`, m: target = r source + t.

    Returns how many correspondences the last round kept; 0, with r and t as in the round before, once fewer than
    MIN_CORRESPONDENCES are within MAX_DISTANCE.
    """
    n = source.shape[0]
    correspondences = make_correspondences(n)
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
        find_neighbours(moved, index, MAX_DISTANCE, correspondences)
        count = 0
        for i in range(n):
            kept[i] = correspondences.neighbour[i] >= 0
            count += kept[i]
        if count < MIN_CORRESPONDENCES:
            return 0
        if trimmed:
            _sort(order, correspondences.distance)
            paired = count
            count, least = _minimise_frmsd(order, correspondences.distance, weight, paired)
            for k in range(count, paired):
                kept[order[k]] = False
        if _update_kept(correspondences.neighbour, neighbour_before, kept, kept_before):
            break
        fit_rigid_motion(moved, index.points, correspondences.neighbour, kept, turn, shift)
        compose(turn, shift, r, t)
        apply_motion(r, t, source, moved)
        if trimmed:
            if abs(previous - least) < _MIN_FRMSD_CHANGE:
                break
            previous = least
        elif _compute_largest_step(turn, shift, moved) < _MIN_STEP:
            break
    return count


@njit(cache=True, nogil=True)
def _update_kept(
    neighbour: NDArray[np.int32], neighbour_before: NDArray[np.int32], kept: NDArray[np.bool_],
    kept_before: NDArray[np.bool_],
) -> bool:  # fmt: skip
    """Whether the kept correspondences are those of the round before, and ICP has converged; stores them if not."""
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
def _compute_largest_step(turn: Array, shift: Array, moved: Array) -> float:
    """m: the largest step by which the motion has moved a point to its place in `moved` (n, 3)."""
    most = 0.0
    for i in range(moved.shape[0]):
        step = 0.0
        for k in range(3):
            y0, y1, y2 = moved[i, 0] - shift[0], moved[i, 1] - shift[1], moved[i, 2] - shift[2]
            step += (moved[i, k] - turn[0, k] * y0 - turn[1, k] * y1 - turn[2, k] * y2) ** 2
        most = max(most, step)
    return np.sqrt(most)


@njit(cache=True, nogil=True)
def _minimise_frmsd(order: NDArray[np.int64], distance: Array, weight: Array, paired: int) -> tuple[int, float]:
    """How many of the `paired` closest correspondences minimise the FRMSD, and that FRMSD, m.

    `weight` (n,) is (k + 1)^(-1 - 2 lambda).
    """
    total = 0.0
    best, count = np.inf, paired
    for k in range(paired):
        d = distance[order[k]]
        total += d * d
        if k + 1 >= MIN_CORRESPONDENCES and total * weight[k] < best:
            best, count = total * weight[k], k + 1
    return count, np.sqrt(best) * paired**LAMBDA


@njit(cache=True, nogil=True)
def _sort(order: NDArray[np.int64], distance: Array) -> None:
    """Sorts `order` (n,), a permutation, by distance (n,); quick if it is nearly sorted already."""
    budget = _MAX_SORTING_STEPS * order.shape[0]
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
