"""The cameras that can be simulated, with their parameters."""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from pretouch_simulation.depth_cameras.drawing import draw_camera
from pretouch_simulation.depth_cameras.errors import DisparityErrors
from pretouch_simulation.depth_cameras.kinect import Kinect
from pretouch_simulation.depth_cameras.masks import Outline
from pretouch_simulation.depth_cameras.matching import Dropouts, Window, WindowCamera
from pretouch_simulation.depth_cameras.rendering import DepthCamera


class CameraModel(StrEnum):
    """Which depth camera is simulated."""

    KINECT = "kinect"
    WINDOW = "window"
    STEREO = "stereo"
    RANDOM = "random"


_OUTLINE = Outline(growth=0.8, shift=0.8, wander=1.2, scale=15.0)
"""An assumption: no data tells how far a client's segmentation is off."""

_XTION = WindowCamera(
    baseline=0.075,
    focal=580.0,
    range=(0.4, 8.0),
    registration=0.8,
    window=Window(size=9.0, edge=1.5, fattening=0.9, raggedness=0.8, gap=1.5, gap_spread=0.7, full_step=6.0),
    dropouts=Dropouts(steepest=1.3, dark=0.01, patch=6.0, speckle=0.003, speck=1.5),
    errors=DisparityErrors(
        noise=((0.5, 0.04), (2.0, 0.05), (4.0, 0.065)),
        distortion=((12.0, 0.04), (60.0, 0.1)),
        gain=0.001,
        offset=0.03,
        body=0.03,
        locking=0.0,
        steps=16.0,
    ),
    outline=_OUTLINE,
)
"""Structured light matched in windows. Fitted to frames of an Asus Xtion and a Kinect v1 (docs/results/cameras.md)."""

_REALSENSE = WindowCamera(
    baseline=0.05,
    focal=425.0,
    range=(0.2, 10.0),
    registration=0.6,
    window=Window(size=9.0, edge=1.0, fattening=1.2, raggedness=1.0, gap=0.5, gap_spread=0.7, full_step=3.0),
    dropouts=Dropouts(steepest=1.35, dark=0.01, patch=8.0, speckle=0.02, speck=1.2),
    errors=DisparityErrors(
        noise=((0.5, 0.01), (2.0, 0.04), (5.0, 0.05)),
        distortion=((20.0, 0.03), (80.0, 0.03)),
        gain=0.002,
        offset=0.02,
        body=0.0,
        locking=0.03,
        steps=32.0,
    ),
    outline=_OUTLINE,
)
"""Stereo of a RealSense D435's baseline and focal length (its data sheet: 50 mm; 848 px wide over 90 deg); its errors
are assumptions, of the size of its data sheet's 0.05 to 0.1 px of subpixel noise."""


def realise(model: CameraModel, rng: np.random.Generator) -> DepthCamera:
    """The camera; of `RANDOM` one whose kind and parameters `rng` draws."""
    if model is CameraModel.KINECT:
        return Kinect()
    if model is CameraModel.WINDOW:
        return _XTION
    if model is CameraModel.STEREO:
        return _REALSENSE
    return draw_camera(rng)
