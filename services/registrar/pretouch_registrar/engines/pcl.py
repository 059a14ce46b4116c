"""Engine `pcl`: PCL's ICP with its rejector `VarTrimmed`, defects included, as the paper's authors used it.

For comparison with results obtained by PCL (checked against 1.13.0). As in PCL:

- points are moved in single precision in each round, so that every round's motion is rounded;
- the rejector sorts the distances in place and then compares the sorted ones with the unsorted pairs: it keeps the
  *first k pairs by index*, not the k closest, so that the order of the source's points decides;
- its FRMSD for k pairs sums the smallest 5 % of the squared distances and the k-th one, instead of the k smallest; k is
  5 % to 95 % of the pairs, and one pair fewer than the best k is kept;
- it has converged at the first of these: the motion's cosine is at least 1 - 1e-8 and its length squared at most 1e-8
  m^2; the mean squared distance changed by less than 1e-12 m^2 or by less than a millionth; 50 rounds. With fewer than
  three pairs it stops where it is.

It has no uncertainty and states the prior's. If the returns cannot determine a pose, since they are too few, on one
line or far from the object, the solution is the prior. A cloud of more than `neighbours.MAX_TARGET` points is
subsampled.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pretouch.geometry import Array, Pose
from pretouch_registrar.engines.camera_model import CameraModel
from pretouch_registrar.engines.icp import LAMBDA, MAX_DISTANCE, MAX_ROUNDS
from pretouch_registrar.engines.neighbours import Index, build_index, find_neighbours, make_correspondences, subsample
from pretouch_registrar.engines.point_matching import solve_by_matching
from pretouch_registrar.engines.registration_problem import RegistrationProblem
from pretouch_registrar.engines.resources import Resources
from pretouch_registrar.engines.rigid import fit_rigid_motion
from pretouch_registrar.engines.solution import Solution

_SHARE = (0.05, 0.95)
_MIN_CORRESPONDENCES = 3
_MIN_COSINE = 1.0 - 1e-8
_MAX_SHIFT_SQUARED = 1e-8
_MIN_ERROR_CHANGE = 1e-12
_MIN_RELATIVE_CHANGE = 1e-6


def solve(problem: RegistrationProblem, model: CameraModel, resources: Resources) -> Solution:
    """The match of the returns above the table with the object's cloud; the prior where there is none."""
    return solve_by_matching(
        problem, lambda source: _match(source, resources.derive_from_model(model, _build_model_index))
    )


def _build_model_index(model: CameraModel) -> Index:
    return build_index(_round_to_single(subsample(model.scene.cloud)))


def align(source: Array, target: Array) -> Pose | None:
    """`target_T_source` for points (n, 3) and (m, 3), m; None if no round found enough pairs."""
    if not len(source) or not len(target):
        return None
    return _match(np.ascontiguousarray(source, dtype=np.float64), build_index(_round_to_single(subsample(target))))


def _match(source: Array, index: Index) -> Pose | None:
    r, t = np.eye(3), np.zeros(3)
    if not match(source, index, r, t):
        return None
    u, _, vt = np.linalg.svd(r)
    return Pose.of(u @ vt, t)


def _round_to_single(points: Array) -> Array:
    return points.astype(np.float32).astype(np.float64)


@njit(cache=True, nogil=True)
def match(source: Array, index: Index, r: Array, t: Array) -> int:
    """Fills r (3, 3), t (3,) with the motion of `source` (n, 3), m, onto the target of `index`: rounded, see above.

    Returns the number of rounds; 0 when none had enough pairs.
    """
    n = source.shape[0]
    moved = np.empty((n, 3))
    for i in range(n):
        for k in range(3):
            moved[i, k] = np.float32(source[i, k])
    correspondences = make_correspondences(n)
    squared = np.empty(n)
    kept = np.empty(n, np.bool_)
    turn, shift = np.eye(3), np.zeros(3)
    total, step = np.eye(4, dtype=np.float32), np.eye(4, dtype=np.float32)
    previous = 1e300
    rounds = 0
    while rounds < MAX_ROUNDS:
        find_neighbours(moved, index, MAX_DISTANCE, correspondences)
        paired = 0
        for i in range(n):
            kept[i] = correspondences.neighbour[i] >= 0
            if kept[i]:
                squared[paired] = correspondences.distance[i] * correspondences.distance[i]
                paired += 1
        count, mean = _count_kept(squared[:paired])
        if count < _MIN_CORRESPONDENCES:
            break
        before = 0
        for i in range(n):
            if kept[i]:
                kept[i] = before < count
                before += 1
        fit_rigid_motion(moved, index.points, correspondences.neighbour, kept, turn, shift)
        for j in range(3):
            for k in range(3):
                step[j, k] = np.float32(turn[j, k])
            step[j, 3] = np.float32(shift[j])
        for i in range(n):
            x, y, z = np.float32(moved[i, 0]), np.float32(moved[i, 1]), np.float32(moved[i, 2])
            for j in range(3):
                moved[i, j] = np.float32(step[j, 0] * x + step[j, 1] * y + step[j, 2] * z + step[j, 3])
        total = step @ total
        rounds += 1
        cosine = 0.5 * (step[0, 0] + step[1, 1] + step[2, 2] - np.float32(1.0))
        shift_squared = step[0, 3] * step[0, 3] + step[1, 3] * step[1, 3] + step[2, 3] * step[2, 3]
        if cosine >= _MIN_COSINE and shift_squared <= _MAX_SHIFT_SQUARED:
            break
        change = abs(mean - previous)
        if change < _MIN_ERROR_CHANGE or change / previous < _MIN_RELATIVE_CHANGE:
            break
        previous = mean
    for j in range(3):
        for k in range(3):
            r[j, k] = total[j, k]
        t[j] = total[j, 3]
    return rounds


@njit(cache=True, nogil=True)
def _count_kept(squared: Array) -> tuple[int, float]:
    """How many pairs, the first ones by index, are kept, and their mean squared distance; squared (n,), m^2."""
    n = squared.shape[0]
    low, high = int(np.floor(_SHARE[0] * n)), int(np.floor(_SHARE[1] * n))
    if high <= low:
        return 0, 0.0
    ordered = np.sort(squared)
    lower = ordered[:low].sum()
    best, least = 0, np.inf
    for k in range(low + 1, high + 1):
        value = (lower + ordered[k - 1]) / k / (k / n) ** (2.0 * LAMBDA)
        if value < least:
            best, least = k - 1, value
    count = int(n * np.float64(np.float32(best / n)))
    limit = ordered[count]
    while count > 0 and ordered[count - 1] >= limit:
        count -= 1
    return count, squared[:count].mean() if count > 0 else 0.0
