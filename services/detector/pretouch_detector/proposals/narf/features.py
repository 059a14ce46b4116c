"""NARF keypoints of an object and their descriptors, from its depth image."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pretouch.camera import Camera, DepthImage
from pretouch_detector.proposals.narf.borders import borders
from pretouch_detector.proposals.narf.change import change
from pretouch_detector.proposals.narf.descriptor import descriptors
from pretouch_detector.proposals.narf.interest import interest
from pretouch_detector.proposals.narf.keypoints import MIN_INTEREST, keypoints
from pretouch_detector.proposals.narf.promising import promising
from pretouch_detector.proposals.narf.range_image import Floats, range_image
from pretouch_detector.proposals.narf.surface import surface


class Features(NamedTuple):
    """Keypoints, the most interesting first.

    Attributes:
        pixels: (n, 2) as (v, u).
        interest: (n,) in [0, 1].
        descriptors: (n, 36) in [-0.5, 0.5], see `descriptor.descriptors`; NaN where there is none.
        poses: (n, 3, 4) `patch_T_camera`: x right, y down, z along the normal away from the camera.
    """

    pixels: NDArray[np.int64]
    interest: Floats
    descriptors: Floats
    poses: Floats


def features(depth: DepthImage, camera: Camera, where: NDArray[np.bool_], support: float) -> Features:
    """The keypoints among the pixels `where` (h, w), with surroundings of `support` m."""
    image = range_image(depth, camera)
    planes = surface(image)
    found = borders(image, planes)
    changes, hidden = change(image, planes, found), found.shadow | found.veil
    candidates = promising(image, changes, hidden, where, support, float(MIN_INTEREST))
    values = interest(image, changes, hidden, candidates, support)
    pixels = keypoints(values, image.points, support)
    described, poses = descriptors(image, pixels, support)
    return Features(pixels, values[pixels[:, 0], pixels[:, 1]], described, poses)
