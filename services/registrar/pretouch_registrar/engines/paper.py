"""Engine `paper`: point-to-point ICP with the outlier rejection of Phillips et al., as published.

After Lancaster, Yang and Smith (IROS 2017) and Phillips, Liu and Tomasi (3DIM 2007), see `icp`; lambda = 0.95. It has
no uncertainty and states the prior's. If the returns cannot determine a pose, since they are too few, on one line or
far from the object, the solution is the prior. A cloud of more than `neighbours.MAX_TARGET` points is subsampled.
"""

from __future__ import annotations

import numpy as np

from pretouch.geometry import Array, Pose
from pretouch_registrar.engines import icp
from pretouch_registrar.engines.camera_model import CameraModel
from pretouch_registrar.engines.neighbours import Index, build_index, subsample
from pretouch_registrar.engines.point_matching import solve_by_matching
from pretouch_registrar.engines.registration_problem import RegistrationProblem
from pretouch_registrar.engines.resources import Resources
from pretouch_registrar.engines.solution import Solution


def solve(problem: RegistrationProblem, model: CameraModel, resources: Resources) -> Solution:
    """The match of the returns above the table with the object's cloud; the prior where there is none."""
    return solve_by_matching(
        problem, lambda source: _match(source, resources.derive_from_model(model, _build_model_index))
    )


def _build_model_index(model: CameraModel) -> Index:
    return build_index(subsample(model.scene.cloud))


def align(source: Array, target: Array) -> Pose | None:
    """`target_T_source` for points (n, 3) and (m, 3), m; None if too few of them are within `icp.MAX_DISTANCE`."""
    if not len(source) or not len(target):
        return None
    return _match(np.ascontiguousarray(source, dtype=np.float64), build_index(subsample(target)))


def _match(source: Array, index: Index) -> Pose | None:
    r, t = np.eye(3), np.zeros(3)
    return Pose.of(r, t) if icp.align(source, index, True, r, t) else None
