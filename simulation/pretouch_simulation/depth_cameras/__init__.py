"""The simulated depth cameras: which ones there are."""

from __future__ import annotations

from enum import StrEnum


class CameraModel(StrEnum):
    """Which depth camera is simulated."""

    KINECT = "kinect"
