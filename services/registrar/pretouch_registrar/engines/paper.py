"""Engine `paper`: point-to-point ICP with the outlier rejection of Phillips et al., as published.

After Lancaster, Yang and Smith (IROS 2017) and Phillips, Liu and Tomasi, "Outlier Robust ICP for Minimizing Fractional
RMSD" (3DIM 2007): each round keeps the k closest pairs for which FRMSD = sqrt(sum of the k smallest squared
distances / k) / (k / n)^lambda is least, with lambda = 0.95. It knows no uncertainty: the prior's is stated.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pretouch.geometry import Array, Pose
from pretouch_registrar.engines.agreement import Problem
from pretouch_registrar.engines.solution import Solution, correction_of

LAMBDA = 0.95
MAX_DISTANCE = 0.05
"""m: pairs further apart are not considered."""
_ROUNDS = 50
_MIN_PAIRS = 6
_OBJECT_HEIGHT = 0.01
"""m: returns higher than this above the table are taken to be the object's."""


def solve(problem: Problem) -> Solution:
    """The match of the returns above the table with the object's cloud; the prior where there are too few."""
    prior = np.diag(1.0 / problem.prior)
    points = problem.beams[problem.beams[:, 6] > 0, :3]
    source = points[points @ problem.table[:3] - problem.table[3] > _OBJECT_HEIGHT]
    scene_T_base = align(source, problem.model.scene.cloud) if len(source) else None
    if scene_T_base is None:
        return Solution(np.zeros(6), prior)
    return Solution(correction_of(scene_T_base.inverse(), problem.centroid), prior)


def align(source: Array, target: Array) -> Pose | None:
    """`target_T_source` for points (n, 3) and (m, 3), m; None when fewer than 6 pairs are within MAX_DISTANCE."""
    tree = cKDTree(target)
    estimate = Pose.identity()
    previous = np.inf
    for _ in range(_ROUNDS):
        moved = estimate.apply(source)
        distance, index = tree.query(moved, distance_upper_bound=MAX_DISTANCE)
        paired = np.flatnonzero(np.isfinite(distance))
        if len(paired) < _MIN_PAIRS:
            return None
        kept, frmsd = _closest(distance[paired])
        chosen = paired[kept]
        estimate = _rigid(moved[chosen], target[index[chosen]]) @ estimate
        if abs(previous - frmsd) < 1e-8:
            break
        previous = frmsd
    return estimate


def _closest(distance: Array) -> tuple[NDArray[np.intp], float]:
    """Indices of the pairs that the least FRMSD keeps, and that FRMSD."""
    order = np.argsort(distance, kind="stable")
    k = np.arange(1, len(order) + 1)
    frmsd = np.sqrt(np.cumsum(distance[order] ** 2) / k) / (k / len(order)) ** LAMBDA
    least = _MIN_PAIRS - 1 + int(np.argmin(frmsd[_MIN_PAIRS - 1 :]))
    return order[: least + 1], float(frmsd[least])


def _rigid(source: Array, target: Array) -> Pose:
    """Least squares `target_T_source` of paired points (n, 3) (Kabsch)."""
    a, b = source.mean(axis=0), target.mean(axis=0)
    u, _, vt = np.linalg.svd((source - a).T @ (target - b))
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))])
    rotation = vt.T @ flip @ u.T
    return Pose.of(rotation, b - rotation @ a)
