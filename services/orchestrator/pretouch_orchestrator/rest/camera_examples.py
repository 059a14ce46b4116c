"""The examples of cameras in the OpenAPI description."""

from __future__ import annotations

from typing import Any

import numpy as np

from pretouch.calibrated_camera import (
    CalibratedCamera,
    CalibrationDrift,
    CalibrationResidual,
    CameraSession,
    CameraSummary,
    LeftOutSession,
)
from pretouch.camera_export import ExportFormat, export_camera
from pretouch.geometry import Pose
from pretouch.wire.json import camera_list_to_json, camera_to_json

_CAMERA = CalibratedCamera(
    id="head",
    sessions=2,
    base_T_camera=Pose.from_quaternion((-0.041, -0.011, 0.517), (0.6533, -0.6533, 0.2706, -0.2706)),
    base_T_camera_covariance=np.diag([1e-4, 1e-4, 1e-4, 4e-6, 4e-6, 4e-6]),
    camera_T_camera=Pose.from_rotation_vector((0.0, 0.01, 0.0), (0.004, -0.011, 0.002)),
    base_T_base=Pose.identity(),
    covariance=np.diag([1e-4] * 3 + [4e-6] * 3 + [4e-4] * 3 + [1e-4] * 3),
    residual=CalibrationResidual(0.002, 0.007),
    drift=CalibrationDrift(),
    history=(
        CameraSession("0f3a9c52d1e84b67", 1767225600.0, 0.0131, 0.0192),
        CameraSession("7be01d4c93a25f80", 1767226200.0, 0.0124, 0.0038),
    ),
    left_out=(LeftOutSession("c41f08e7a6b2d935", 1767226800.0, "Its samples fit no pose."),),
)
_SUMMARY = CameraSummary(
    _CAMERA.id, _CAMERA.sessions, _CAMERA.camera_T_camera, _CAMERA.base_T_base, _CAMERA.residual, _CAMERA.drift
)
CAMERA = camera_to_json(_CAMERA)
CAMERA_LIST = camera_list_to_json([_SUMMARY])
DOCUMENTS: dict[str, list[dict[str, Any]]] = {"CalibratedCamera": [CAMERA], "CameraList": [CAMERA_LIST]}
"""The examples of each schema."""
EXPORTS = {format: export_camera(_CAMERA, format) for format in ExportFormat}
