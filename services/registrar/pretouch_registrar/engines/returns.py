"""What the point-cloud engines match: the returns above the table, against the object's points."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from pretouch.geometry import Array, Pose
from pretouch_registrar.engines.camera_model import CameraModel
from pretouch_registrar.engines.problem import Problem
from pretouch_registrar.engines.solution import Solution, correction_of

OBJECT_HEIGHT = 0.01
"""m: returns higher than this above the table are taken to be the object's."""
MAX_SOURCE = 5000
"""More returns are thinned out to this many, evenly in their order."""
_LINE = 0.002
"""m: points that spread less than this across their longest axis are no more than a line and its noise."""

T = TypeVar("T")


def object_returns(problem: Problem) -> NDArray[np.intp]:
    """Rows of `problem.beams` whose returns are the object's."""
    beams = problem.beams
    above = beams[:, :3] @ problem.table[:3] - problem.table[3] > OBJECT_HEIGHT
    rows = np.flatnonzero((beams[:, 6] > 0) & above)
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
    source = problem.beams[object_returns(problem), :3]
    scene_T_base = None if fixes_no_turn(source) else match(source)
    if scene_T_base is None:
        return Solution(np.zeros(6), prior)
    return Solution(correction_of(scene_T_base.inverse(), problem.centroid), prior)


class OncePerModel(Generic[T]):
    """Keeps what is worked out from a camera model for as long as that model lives."""

    def __init__(self, make: Callable[[CameraModel], T]) -> None:
        self._make = make
        self._kept: weakref.WeakKeyDictionary[CameraModel, T] = weakref.WeakKeyDictionary()

    def __call__(self, model: CameraModel) -> T:
        """The result for `model`; two threads may make the same one at the same time."""
        known = self._kept.get(model)
        if known is None:
            known = self._kept[model] = self._make(model)
        return known
