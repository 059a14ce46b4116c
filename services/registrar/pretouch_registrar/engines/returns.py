"""What the point-cloud engines match: the returns above the table, against the object's points."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pretouch.geometry import Array, Pose
from pretouch_registrar.engines.problem import Problem
from pretouch_registrar.engines.solution import Solution, correction_of

OBJECT_HEIGHT = 0.01
"""m: returns higher than this above the table are taken to be the object's."""
MAX_SOURCE = 5000
"""More returns are thinned out to this many, evenly in their order."""
_LINE = 0.002
"""m: points that spread less than this across their longest axis are no more than a line and its noise."""


def object_returns(problem: Problem) -> NDArray[np.intp]:
    """Numbers of the beams whose returns are the object's."""
    beams, table = problem.beams, problem.target.table
    above = beams.points @ table.normal - table.offset > OBJECT_HEIGHT
    rows = np.flatnonzero(beams.returned & above)
    return rows[:: max(1, -(-len(rows) // MAX_SOURCE))]


def fixes_no_turn(points: Array) -> bool:
    """Whether points (n, 3), m, lie at one place or on one line, so that a turn about it is free."""
    if len(points) < 3:
        return True
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) / np.sqrt(len(points))
    return bool(spread[1] < _LINE)


def matched(problem: Problem, match: Callable[[Array], Pose | None]) -> Solution:
    """The match of the returns above the table by an engine that knows no uncertainty; the prior where there is none.

    `match` gives `scene_T_base` for points (n, 3), m, or None.
    """
    prior = np.diag(1.0 / problem.prior)
    source = problem.beams.points[object_returns(problem)]
    scene_T_base = None if fixes_no_turn(source) else match(source)
    if scene_T_base is None:
        return Solution(np.zeros(6), prior)
    return Solution(correction_of(scene_T_base.inverse(), problem.target.centroid), prior)
