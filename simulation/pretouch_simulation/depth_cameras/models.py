"""The depth cameras that can be simulated."""

from __future__ import annotations

from enum import StrEnum
from importlib import import_module

import numpy as np

from pretouch_simulation.depth_cameras.rendering import DepthCamera


class CameraModel(StrEnum):
    """Which depth camera is simulated: each is the module of its name here, with `draw(rng) -> DepthCamera`."""

    KINECT = "kinect"
    WINDOW = "window"
    STEREO = "stereo"
    RANDOM = "random"


def realise(model: CameraModel, rng: np.random.Generator) -> DepthCamera:
    """The camera; of `RANDOM` one whose kind and parameters `rng` draws."""
    camera: DepthCamera = import_module(f"pretouch_simulation.depth_cameras.{model.value}").draw(rng)
    return camera
