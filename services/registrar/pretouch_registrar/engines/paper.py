"""Engine `paper`: point-to-point ICP with the outlier rejection of Phillips et al., as published.

After Lancaster, Yang and Smith (IROS 2017) and Phillips, Liu and Tomasi (3DIM 2007), see `icp`; lambda = 0.95. It knows
no uncertainty: the prior's is stated. Where the returns cannot fix a pose, being too few, on one line or nowhere near
the object, the prior itself is the answer. A cloud of more than `neighbours.MAX_TARGET` points is thinned out.
"""

from __future__ import annotations

import numpy as np

from pretouch.geometry import Array, Pose
from pretouch_registrar.engines import icp
from pretouch_registrar.engines.camera_model import CameraModel
from pretouch_registrar.engines.neighbours import Index, index_of, thinned
from pretouch_registrar.engines.problem import Problem
from pretouch_registrar.engines.resources import Resources
from pretouch_registrar.engines.returns import matched
from pretouch_registrar.engines.solution import Solution


def solve(problem: Problem, model: CameraModel, resources: Resources) -> Solution:
    """The match of the returns above the table with the object's cloud; the prior where there is none."""
    return matched(problem, lambda source: _match(source, resources.of_model(model, _index)))


def _index(model: CameraModel) -> Index:
    return index_of(thinned(model.scene.cloud))


def align(source: Array, target: Array) -> Pose | None:
    """`target_T_source` for points (n, 3) and (m, 3), m; None when fewer than 6 pairs are within `icp.MAX_DISTANCE`."""
    if not len(source) or not len(target):
        return None
    return _match(np.ascontiguousarray(source, dtype=np.float64), index_of(thinned(target)))


def _match(source: Array, index: Index) -> Pose | None:
    r, t = np.eye(3), np.zeros(3)
    return Pose.of(r, t) if icp.align(source, index, True, r, t) else None
