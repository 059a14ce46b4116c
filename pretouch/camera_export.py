"""The corrected pose of a camera, as a robot's configuration takes it: JSON, YAML or a joint of a URDF."""

from __future__ import annotations

import json
from collections.abc import Callable
from enum import StrEnum
from typing import Any

import numpy as np

from pretouch.calibrated_camera import CalibratedCamera
from pretouch.errors import Conflict
from pretouch.geometry import Array, Pose

_GIMBAL_LOCK = 1e-9
"""cos(pitch) below which roll and yaw turn about the same axis."""


class ExportFormat(StrEnum):
    """How a camera's corrected pose is written."""

    JSON = "json"
    YAML = "yaml"
    URDF = "urdf"


def export_camera(camera: CalibratedCamera, format: ExportFormat) -> str:
    """The corrected base_T_camera with its covariance, as text that ends in a line break.

    Raises:
        Conflict: nothing is known of the camera, or nothing since it moved.
    """
    if camera.base_T_camera_covariance is None:
        raise Conflict(
            f"Nothing is known of the pose of camera {camera.id} yet"
            + ("." if camera.drift.state == "steady" else f": it is {camera.drift.state}."),
            "Run sessions with this camera.id that converge, then export it.",
        )
    return _WRITERS[format](camera, np.asarray(camera.base_T_camera_covariance))


def roll_pitch_yaw(rotation: Array) -> Array:
    """(3,), rad: the 3x3 rotation Rz(yaw) Ry(pitch) Rx(roll), as URDF writes it; roll is 0 where pitch is +-90 deg.

    Source: the fixed-axis angles of the URDF specification, https://wiki.ros.org/urdf/XML/joint.
    """
    cos_pitch = float(np.hypot(rotation[0, 0], rotation[1, 0]))
    pitch = np.arctan2(-rotation[2, 0], cos_pitch)
    if cos_pitch < _GIMBAL_LOCK:
        return np.array([0.0, pitch, np.arctan2(-rotation[0, 1], rotation[1, 1])])
    roll = np.arctan2(rotation[2, 1], rotation[2, 2])
    return np.array([roll, pitch, np.arctan2(rotation[1, 0], rotation[0, 0])])


def _write_json(camera: CalibratedCamera, covariance: Array) -> str:
    document: dict[str, Any] = {
        "camera": camera.id,
        "sessions": camera.sessions,
        "base_T_camera": _describe_pose(camera.base_T_camera),
        "covariance": covariance.tolist(),
    }
    return json.dumps(document, indent=2) + "\n"


def _write_yaml(camera: CalibratedCamera, covariance: Array) -> str:
    pose = _describe_pose(camera.base_T_camera)
    rows = "".join(f"  - {json.dumps(row)}\n" for row in covariance.tolist())
    return (
        "# The camera in the robot's base; x right, y down, z forward. Metres; quaternion x, y, z, w.\n"
        "# Covariance: order (rotation vector, translation), base axes, about the camera; rad^2, rad m, m^2.\n"
        f"camera: {json.dumps(camera.id)}\n"
        f"sessions: {camera.sessions}\n"
        "base_T_camera:\n"
        f"  translation: {json.dumps(pose['translation'])}\n"
        f"  rotation: {json.dumps(pose['rotation'])}\n"
        f"covariance:\n{rows}"
    )


def _write_urdf(camera: CalibratedCamera, covariance: Array) -> str:
    xyz = " ".join(f"{value:.9g}" for value in camera.base_T_camera.translation)
    rpy = " ".join(f"{value:.9g}" for value in roll_pitch_yaw(camera.base_T_camera.rotation))
    std = np.sqrt(np.diag(covariance))
    turn, shift = (" ".join(f"{value:.2g}" for value in part) for part in (np.degrees(std[:3]), 1000 * std[3:]))
    name = camera.id.replace("--", "-_")  # a comment must not hold two hyphens
    return (
        f"<!-- pretouch: camera {name}, {camera.sessions} sessions; in base, standard deviations of {turn} deg about "
        f"and {shift} mm along x y z.\n"
        "     The child is the optical frame: x right, y down, z forward. -->\n"
        f'<joint name="{camera.id}_joint" type="fixed">\n'
        '  <parent link="base_link"/>\n'
        f'  <child link="{camera.id}_optical_frame"/>\n'
        f'  <origin xyz="{xyz}" rpy="{rpy}"/>\n'
        "</joint>\n"
    )


def _describe_pose(pose: Pose) -> dict[str, Any]:
    return {"translation": pose.translation.tolist(), "rotation": pose.quaternion.tolist()}


_WRITERS: dict[ExportFormat, Callable[[CalibratedCamera, Array], str]] = {
    ExportFormat.JSON: _write_json,
    ExportFormat.YAML: _write_yaml,
    ExportFormat.URDF: _write_urdf,
}
