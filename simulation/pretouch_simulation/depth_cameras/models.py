"""The cameras that can be simulated, with their parameters."""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from pretouch_simulation.depth_cameras.drawing import drawn
from pretouch_simulation.depth_cameras.errors import DisparityErrors
from pretouch_simulation.depth_cameras.kinect import Kinect
from pretouch_simulation.depth_cameras.masks import Outline
from pretouch_simulation.depth_cameras.matching import Dropouts, Window, WindowCamera
from pretouch_simulation.depth_cameras.rendering import DepthCamera


class CameraModel(StrEnum):
    """Which depth camera looks."""

    KINECT = "kinect"
    WINDOW = "window"
    STEREO = "stereo"
    RANDOM = "random"


WINDOW = WindowCamera(
    baseline=0.075,
    focal=580.0,
    range=(0.4, 8.0),
    window=Window(size=9.0, edge=1.5, fattening=0.0, raggedness=0.7, gap=3.0, full_step=6.0),
    dropouts=Dropouts(steepest=1.3, dark=0.01, patch=6.0, speckle=0.003, speck=1.5),
    errors=DisparityErrors(
        noise=((0.5, 0.05), (2.0, 0.06), (5.0, 0.06)),
        distortion=((20.0, 0.04), (80.0, 0.06)),
        gain=0.002,
        offset=0.04,
        body=0.05,
        locking=0.0,
        steps=8.0,
    ),
    outline=Outline(growth=0.8, shift=0.8, wander=1.2, scale=15.0),
)
"""Structured light matched in windows: an Xtion, a Kinect v1. Fitted (docs/results/cameras.md)."""

STEREO = WindowCamera(
    baseline=0.05,
    focal=425.0,
    range=(0.2, 10.0),
    window=Window(size=9.0, edge=1.0, fattening=1.0, raggedness=0.9, gap=0.5, full_step=3.0),
    dropouts=Dropouts(steepest=1.35, dark=0.01, patch=8.0, speckle=0.02, speck=1.2),
    errors=DisparityErrors(
        noise=((0.5, 0.02), (2.0, 0.06), (5.0, 0.06)),
        distortion=((20.0, 0.03), (80.0, 0.04)),
        gain=0.003,
        offset=0.05,
        body=0.0,
        locking=0.04,
        steps=32.0,
    ),
    outline=Outline(growth=0.8, shift=0.8, wander=1.2, scale=15.0),
)
"""Stereo with a baseline of 5 cm: a RealSense D435."""


def realise(model: CameraModel, rng: np.random.Generator) -> DepthCamera:
    """The camera; of `RANDOM` one whose kind and parameters `rng` draws."""
    if model is CameraModel.KINECT:
        return Kinect()
    if model is CameraModel.WINDOW:
        return WINDOW
    if model is CameraModel.STEREO:
        return STEREO
    return drawn(rng)
