"""`window`: structured light matched in windows.

Fitted to frames of an Asus Xtion and a Kinect v1 (docs/results/cameras.md).
"""

from __future__ import annotations

import numpy as np

from pretouch_simulation.depth_cameras.errors import DisparityErrors
from pretouch_simulation.depth_cameras.masks import ASSUMED_OUTLINE
from pretouch_simulation.depth_cameras.matching import Dropouts, Window, WindowCamera

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
    outline=ASSUMED_OUTLINE,
)


def draw(rng: np.random.Generator) -> WindowCamera:
    """The camera; nothing about it varies."""
    return _XTION
