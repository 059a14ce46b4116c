"""From a keypoint to the rectangle that the paper scans."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pretouch.camera import Camera
from pretouch.rectangle import ProposedRegion, RotatedRectangle
from pretouch_detector.proposals.narf.range_image import Floats

_LONGEST = 3.3
"""The longer side over the shorter one is at most this, as in proposer `random`; the paper does not say."""


def make_region(
    pixel: NDArray[np.int64], descriptor: Floats, patch_T_camera: Floats, camera: Camera, area: float
) -> ProposedRegion:
    """The rectangle about a keypoint (v, u), `area` in square pixels.

    Its first axis lies along the beam of the largest element of `descriptor` (36,), as the camera sees it; the second
    element is the larger of the two beams at a right angle to it. The sides are to each other as these two (our reading
    of Lancaster et al. 2017), the confidence is their sum.
    """
    quarter = len(descriptor) // 4
    first = int(np.argmax(descriptor))
    largest = float(descriptor[first])
    second = float(max(descriptor[first - quarter], descriptor[(first + quarter) % len(descriptor)]))
    aspect = float(np.clip(largest / second, 1.0, _LONGEST)) if second > 0 else _LONGEST
    theta = _project_angle(first * 2 * np.pi / len(descriptor), pixel, patch_T_camera, camera)
    width = float(np.sqrt(area * aspect))
    rectangle = RotatedRectangle(float(pixel[1]), float(pixel[0]), width, area / width, theta)
    return ProposedRegion(rectangle, float(np.clip(largest + second, 0.0, 1.0)))


def _project_angle(beam: float, pixel: NDArray[np.int64], patch_T_camera: Floats, camera: Camera) -> float:
    """rad, from +u towards +v: a beam, `beam` rad clockwise from the patch's upward axis, in the image at `pixel`."""
    x, y, z = np.array([np.sin(beam), -np.cos(beam), 0.0]) @ patch_T_camera[:, :3].astype(np.float64)
    a, b = (pixel[1] - camera.cx) / camera.fx, (pixel[0] - camera.cy) / camera.fy
    return float(np.arctan2(camera.fy * (y - b * z), camera.fx * (x - a * z)))
