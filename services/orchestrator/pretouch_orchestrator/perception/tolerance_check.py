"""Whether the points of `tolerance.at` are where the object is."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from pretouch.errors import InvalidInput
from pretouch.geometry import Array, Pose
from pretouch.scene import Scene
from pretouch.session import SessionRequest
from pretouch.session_warning import SessionWarning

_NEAR, _FAR, _IMPOSSIBLE = 0.1, 0.25, 1.0
"""m from the object's nearest visible point, in the median: where a grasp of it has its contacts; farther than any; and
so far that a degree is two centimetres, where the points are most often in another unit or frame."""

_MILLIMETRES = 10.0
"""m: farther from its base no robot has anything at hand."""


class _Mistake(NamedTuple):
    """What the points look like, what to send, and by how much and by which pose they are then mapped to base."""

    text: str
    remedy: str
    scale: float
    base_T_points: Pose


def check_points(request: SessionRequest, scene: Scene) -> list[SessionWarning]:
    """What is odd about where the points are.

    Raises:
        InvalidInput: they cannot be points of this object.
    """
    at = request.tolerance.at
    if at is None:
        return []
    near = cKDTree(scene.cloud)
    distance = _measure_distance(near, at)
    if distance <= _FAR:
        return []
    detail = (
        f"The points of tolerance.at are {distance:.3g} m from the object, in the median.{_explain(request, at, near)}"
    )
    remedy = "Send points in base, in metres, where this base_T_camera puts them."
    if distance > _IMPOSSIBLE:
        raise InvalidInput(detail, remedy)
    return [SessionWarning("tolerance-points-far", detail, f"{remedy} If the error counts there, this is right.")]


def _explain(request: SessionRequest, at: Array, near: cKDTree) -> str:
    """The mistake that, mended, brings the points nearest to the object, if it is there: a sentence, or nothing."""
    if np.abs(at).max() > _MILLIMETRES:
        mistakes = [
            _Mistake("in millimetres", "metres", 0.001, Pose.identity()),
            _Mistake("in millimetres in the camera's frame", "metres in base", 0.001, request.base_T_camera),
        ]
    else:
        mistakes = [_Mistake("in the camera's frame", "points in base", 1.0, request.base_T_camera)]
    if request.base_T_object is not None:
        mistakes.append(_Mistake("in the object's frame", "points in base", 1.0, request.base_T_object))
    distances = [_measure_distance(near, each.base_T_points.apply(each.scale * at)) for each in mistakes]
    best = int(np.argmin(distances))
    if distances[best] > _NEAR:
        return ""
    return f" They look like points {mistakes[best].text}: send {mistakes[best].remedy}."


def _measure_distance(near: cKDTree, points: Array) -> float:
    """m, median: from the points (k, 3), m, to the nearest of the object's."""
    return float(np.median(near.query(points)[0]))
