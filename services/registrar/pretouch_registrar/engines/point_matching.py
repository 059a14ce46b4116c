"""What the engines that match points share: the source, the returns above the table, and the fallback to the prior."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pretouch.geometry import Array, Pose
from pretouch_registrar.engines.registration_problem import RegistrationProblem
from pretouch_registrar.engines.solution import Solution, correction_from_pose

OBJECT_HEIGHT = 0.01
"""m: returns higher than this above the table are taken to be on the object."""
MAX_SOURCE = 5000
"""More returns are subsampled to this many, evenly in their order."""
_LINE = 0.002
"""m: points with a smaller standard deviation across their longest axis are taken to be collinear."""


def select_object_returns(problem: RegistrationProblem) -> NDArray[np.intp]:
    """Indices of the beams whose returns are on the object."""
    beams, table = problem.beams, problem.target.table
    above = beams.points @ table.normal - table.offset > OBJECT_HEIGHT
    rows = np.flatnonzero(beams.returned & above)
    return rows[:: max(1, -(-len(rows) // MAX_SOURCE))]


def is_collinear(points: Array) -> bool:
    """Whether points (n, 3), m, lie on one line, so that a rotation about it is not constrained."""
    if len(points) < 3:
        return True
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) / np.sqrt(len(points))
    return bool(spread[1] < _LINE)


def solve_by_matching(problem: RegistrationProblem, match: Callable[[Array], Pose | None]) -> Solution:
    """The solution of an engine without uncertainty: its match of the returns above the table.

    It is the prior if there is no match.

    Args:
        match: finds `scene_T_base` for points (n, 3), m, or None.
    """
    prior = problem.prior.covariance
    source = problem.beams.points[select_object_returns(problem)]
    scene_T_base = None if is_collinear(source) else match(source)
    if scene_T_base is None:
        return Solution(np.zeros(6), prior)
    return Solution(correction_from_pose(scene_T_base.inverse(), problem.target.centroid), prior)
