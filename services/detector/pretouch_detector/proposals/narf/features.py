"""NARF keypoints of an object and their descriptors, from its depth image."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pretouch.camera import Camera, DepthImage
from pretouch_detector.proposals.narf.borders import find_borders
from pretouch_detector.proposals.narf.change import measure_change
from pretouch_detector.proposals.narf.descriptor import describe_keypoints
from pretouch_detector.proposals.narf.interest import compute_interest
from pretouch_detector.proposals.narf.keypoints import MIN_INTEREST, find_keypoints
from pretouch_detector.proposals.narf.promising import find_promising
from pretouch_detector.proposals.narf.range_image import Floats, make_range_image
from pretouch_detector.proposals.narf.surface import fit_surface


class Features(NamedTuple):
    """Keypoints, the most interesting first.

    Attributes:
        pixels: (n, 2) as (v, u).
        interest: (n,) in [0, 1].
        descriptors: (n, 36) in [-0.5, 0.5], see `descriptor.describe_keypoints`; NaN where there is none.
        poses: (n, 3, 4) `patch_T_camera`: x right, y down, z along the normal away from the camera.
    """

    pixels: NDArray[np.int64]
    interest: Floats
    descriptors: Floats
    poses: Floats


def find_features(depth: DepthImage, camera: Camera, where: NDArray[np.bool_], support: float) -> Features:
    """The keypoints among the pixels `where` (h, w), with surroundings of `support` m."""
    image = make_range_image(depth, camera)
    planes = fit_surface(image)
    found = find_borders(image, planes)
    changes, hidden = measure_change(image, planes, found), found.shadow | found.veil
    candidates = find_promising(image, changes, hidden, where, support, float(MIN_INTEREST))
    values = compute_interest(image, changes, hidden, candidates, support)
    pixels = find_keypoints(values, image.points, support)
    described, poses = describe_keypoints(image, pixels, support)
    return Features(pixels, values[pixels[:, 0], pixels[:, 1]], described, poses)
