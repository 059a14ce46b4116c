"""Whether the camera's pose and the depth's unit put table and object where a robot can have them.

Where they do not, the mistakes that users make are tried one by one: one that explains what is seen is named.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from pretouch.geometry import Array, Plane, Pose
from pretouch.scene import Scene
from pretouch.session import SessionRequest
from pretouch.session_warning import SessionWarning
from pretouch_orchestrator.perception.depth_check import measure_size, suggest_scales

_MAX_TILT = np.radians(12.0)
"""rad from level, or from the table that was given: calibration errors and feet of robots are less."""
_MAX_DEPTH, _MAX_REACH, _MAX_TABLE, _MAX_SIZE = 2.0, 2.5, 1.5, 1.0
"""m: from the camera to the object, from base to it, the table above or below base, the object's length."""
_MAX_GAP = 0.10
"""m between the table that was given and the one that is seen, at the object."""
_MIN_MILLIMETRES = 150.0
"""mm from base to a camera at the least."""
_MAX_OBJECT_OFFSET = 0.5
"""m between the object's points and the origin of `base_T_object`, besides the object's size."""


class _View(NamedTuple):
    """What the camera sees in its own frame: the table, the object's middle and length; m."""

    table: Plane
    middle: Array
    size: float

    def scaled(self, factor: float) -> _View:
        return _View(Plane(self.table.normal, factor * self.table.offset), factor * self.middle, factor * self.size)


class _Placement(NamedTuple):
    """Where a view is in base.

    Attributes:
        tilt: rad, of the table that is seen against base's xy-plane, or against the table that was given.
        depth, reach, level, size: m, from the camera to the object, from base to it, of the table over base, and the
            object's length.
        gap: m, from the table that was given to the one that is seen, at the object; 0 if none was given.
    """

    tilt: float
    depth: float
    reach: float
    level: float
    size: float
    gap: float

    @staticmethod
    def of(view: _View, base_T_camera: Pose, given: Plane | None) -> _Placement:
        table, middle = view.table.moved(base_T_camera), base_T_camera.apply(view.middle)
        up = np.array([0.0, 0.0, 1.0]) if given is None else given.normal
        foot = middle - table.height(middle) * table.normal
        return _Placement(
            tilt=float(np.arccos(np.clip(table.normal @ up, -1, 1))),
            depth=float(view.middle[2]),
            reach=float(np.linalg.norm(middle)),
            level=float(foot @ up),
            size=view.size,
            gap=0.0 if given is None else float(abs(given.height(foot))),
        )

    @property
    def is_usual(self) -> bool:
        return (
            self.tilt <= _MAX_TILT
            and self.depth <= _MAX_DEPTH
            and self.reach <= _MAX_REACH
            and abs(self.level) <= _MAX_TABLE
            and self.size <= _MAX_SIZE
            and self.gap <= _MAX_GAP
        )


class _Mistake(NamedTuple):
    """A mistake in `base_T_camera`: what it looks like, and the pose that was meant."""

    code: str
    text: str
    remedy: str
    mend: Callable[[Pose], Pose]


def _reorder(pose: Pose) -> Pose:
    w, x, y, z = pose.quaternion
    return Pose.from_quaternion(pose.translation, [x, y, z, w])


_LINK_T_OPTICAL = Pose.of([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], np.zeros(3))
_OPENGL_T_OPTICAL = Pose.of(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
_MILLIMETRES = _Mistake(
    "pose-millimetres",
    "looks like one in millimetres",
    "Send metres.",
    lambda pose: Pose.of(pose.rotation, pose.translation / 1000),
)
_MISTAKES = (
    _Mistake(
        "pose-inverted", "looks inverted", "Send the camera's pose in base, not base's in the camera.", Pose.inverse
    ),
    _Mistake(
        "pose-opengl",
        "looks like that of a camera with OpenGL axes (y up, z backward)",
        "Send the pose of the optical frame: x right, y down, z forward. Turn yours by 180 degrees about its x axis.",
        lambda pose: pose @ _OPENGL_T_OPTICAL,
    ),
    _Mistake(
        "pose-link-frame",
        "looks like that of the camera's link frame (x forward, z up)",
        "Send the pose of the optical frame: x right, y down, z forward; in ROS the frame of the image's header.",
        lambda pose: pose @ _LINK_T_OPTICAL,
    ),
    _Mistake(
        "pose-wxyz",
        "looks like one with a quaternion in the order w, x, y, z",
        "Send the rotation as x, y, z, w.",
        _reorder,
    ),
    _MILLIMETRES,
)
_SCALES = (1000.0, 10.0, 0.2, 0.25, 0.1, 0.01, 0.001)
"""Factors by which the depth may be wrong."""


def check_placement(request: SessionRequest, scene: Scene, seen: Plane | None) -> list[SessionWarning]:
    """What is odd about where the object and the table are.

    Args:
        scene: with the table that was given, if one was.
        seen: the table that the image shows, in the camera frame; None: it shows none, and nothing is said about it.
    """
    warnings = _check_object_pose(request, scene)
    if request.base_T_camera.is_close(Pose.identity(), 0.0):
        return [
            SessionWarning(
                "pose-identity",
                "base_T_camera is the identity.",
                "Send the pose of the camera's optical frame in base. If base is the camera, this is right.",
            ),
            *warnings,
        ]
    if seen is None:
        return warnings
    middle = request.base_T_camera.inverse().apply(scene.centroid)
    view, given = _View(seen, middle, measure_size(scene.cloud)), request.table
    placement = _Placement.of(view, request.base_T_camera, given)
    if placement.is_usual:
        return warnings
    return [*(_explain(view, request, placement, scene) or _describe(placement, scene, given)), *warnings]


def _explain(view: _View, request: SessionRequest, placement: _Placement, scene: Scene) -> list[SessionWarning]:
    """The mistake that explains the placement; of several the one that makes the table most level."""
    mended = {mistake: _Placement.of(view, mistake.mend(request.base_T_camera), request.table) for mistake in _MISTAKES}
    usual = [(mistake, found) for mistake, found in mended.items() if found.is_usual]
    if np.linalg.norm(request.base_T_camera.translation) < _MIN_MILLIMETRES:
        usual = [(mistake, found) for mistake, found in usual if mistake is not _MILLIMETRES]
    if usual:
        mistake, found = min(usual, key=lambda each: each[1].tilt)
        others = [other.text for other, _ in usual if other is not mistake]
        return [
            SessionWarning(
                mistake.code,
                f"base_T_camera {mistake.text}: as it is, {_say(placement, request.table)}; read so, "
                f"{_say(found, request.table)}." + (f" It also {' and '.join(others)}." if others else ""),
                f"{mistake.remedy}{_excuse_tilt(placement, request.table)}",
            )
        ]
    if placement._replace(depth=0.0).is_usual:  # a camera that is far away puts all else where it is
        return []
    for factor in _SCALES:
        found = _Placement.of(view.scaled(factor), request.base_T_camera, request.table)
        if found.is_usual:
            return [
                SessionWarning(
                    "depth-scale",
                    f"The depth looks several times too {'large' if factor < 1 else 'small'}: with depth_scale "
                    f"{scene.depth.scale:g} the object is {placement.depth:.3g} m from the camera, in the median, and "
                    f"{placement.size:.2g} m long.{suggest_scales(scene.depth, placement.depth)}",
                    "Send camera.depth_scale, the metres of one stored unit. If the camera is so far, this is right.",
                )
            ]
    return []


def _excuse_tilt(placement: _Placement, given: Plane | None) -> str:
    if given is not None or placement.tilt <= _MAX_TILT:
        return ""
    return " If the robot's base is mounted on a wall or a ceiling, this is right: send table, and nothing is said."


def _say(placement: _Placement, given: Plane | None) -> str:
    against = "level" if given is None else "the given table"
    return (
        f"the table is {np.degrees(placement.tilt):.0f} degrees from {against} and the object "
        f"{placement.reach:.2f} m from base"
    )


def _describe(placement: _Placement, scene: Scene, given: Plane | None) -> list[SessionWarning]:
    """What is unusual, where no known mistake explains it."""
    warnings = []
    if placement.tilt > _MAX_TILT or placement.gap > _MAX_GAP:
        below = "; the camera is below it" if placement.tilt > np.pi / 2 else ""
        if given is None:
            detail = f"The table is {np.degrees(placement.tilt):.0f} degrees from level in base{below}."
        else:
            detail = (
                f"The table that the image shows is {np.degrees(placement.tilt):.0f} degrees and, at the object, "
                f"{placement.gap:.2f} m from the one that was given{below}."
            )
        remedy = f"Check base_T_camera, and table if one was given.{_excuse_tilt(placement, given)}"
        warnings.append(SessionWarning("table-tilted" if given is None else "table-mismatch", detail, remedy))
    if placement.depth > _MAX_DEPTH or placement.size > _MAX_SIZE:
        warnings.append(
            SessionWarning(
                "camera-far",
                f"The object is {placement.depth:.2f} m from the camera, in the median, and {placement.size:.2f} m "
                f"long, with depth_scale {scene.depth.scale:g}.{suggest_scales(scene.depth, placement.depth)}",
                "Check camera.depth_scale and the focal lengths. If it is so, move the camera nearer: its noise "
                "grows with the square of the distance.",
            )
        )
    if placement.reach > _MAX_REACH or abs(placement.level) > _MAX_TABLE:
        warnings.append(
            SessionWarning(
                "object-far",
                f"The object is {placement.reach:.2f} m from base's origin, the table {placement.level:.2f} m above.",
                "Check base_T_camera: metres, in the frame of the robot's own base. If base is a map, this is right.",
            )
        )
    return warnings


def _check_object_pose(request: SessionRequest, scene: Scene) -> list[SessionWarning]:
    if request.base_T_object is None:
        return []
    distance = float(np.linalg.norm(request.base_T_object.translation - scene.centroid))
    if distance <= _MAX_OBJECT_OFFSET + measure_size(scene.cloud):
        return []
    return [
        SessionWarning(
            "object-pose-far",
            f"base_T_object is {distance:.2f} m from the object's points.",
            "Send the pose of the object that the mask marks, in base, by this base_T_camera.",
        )
    ]
