"""The depth image as NARF reads it: a point and a range for each pixel."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pretouch.camera import Camera, DepthImage

Floats = NDArray[np.float32]


class RangeImage(NamedTuple):
    """A planar range image in single precision, as PCL keeps it.

    Attributes:
        points: (h, w, 3), m, in the camera frame; NaN where there is no data.
        ranges: (h, w), m, distance from the camera's centre; NaN where there is no data.
        optics: (4,) 1 / fx, 1 / fy, cx, cy.
    """

    points: Floats
    ranges: Floats
    optics: Floats


def make_range_image(depth: DepthImage, camera: Camera) -> RangeImage:
    """The points of `depth` seen by `camera`."""
    one = np.float32(1)
    optics = np.array([one / np.float32(camera.fx), one / np.float32(camera.fy), camera.cx, camera.cy], np.float32)
    z = np.where(depth.metres > 0, depth.metres, np.float32(np.nan))
    v, u = np.indices(z.shape, dtype=np.float32)
    x, y = (u - optics[2]) * z * optics[0], (v - optics[3]) * z * optics[1]
    return RangeImage(np.stack([x, y, z], axis=-1), np.sqrt(x * x + (y * y + z * z)), optics)
