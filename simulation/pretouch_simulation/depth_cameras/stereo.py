"""`stereo`: stereo matched in windows.

Of a RealSense D435's baseline and focal length (its data sheet: 50 mm; 848 px wide over 90 deg); its errors are
assumptions, of the size of its data sheet's 0.05 to 0.1 px of subpixel noise.
"""

from __future__ import annotations

import numpy as np

from pretouch_simulation.depth_cameras.errors import DisparityErrors
from pretouch_simulation.depth_cameras.masks import ASSUMED_OUTLINE
from pretouch_simulation.depth_cameras.matching import Dropouts, Window, WindowCamera

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
    outline=ASSUMED_OUTLINE,
)


def draw(rng: np.random.Generator) -> WindowCamera:
    """The camera; nothing about it varies."""
    return _REALSENSE
