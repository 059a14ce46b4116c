"""Proposer `narf`: the regions that Lancaster et al. 2017 compare their network with.

A rectangle about each NARF keypoint of the object, turned and shaped by the keypoint's descriptor; after Steder, Rusu,
Konolige, Burgard, "Point Feature Extraction on 3D Range Scans Taking into Account Object Boundaries", ICRA 2011. The
borders, the complete interest image, keypoints and descriptors are those of PCL 1.13, to the bit.
"""

from __future__ import annotations

import numpy as np

from pretouch.camera import Camera, DepthImage
from pretouch.rectangle import ProposedRegion
from pretouch.scene import Scene
from pretouch.tof import Sensor
from pretouch_detector.proposals.narf.features import find_features
from pretouch_detector.proposals.narf.rectangles import make_region

SUPPORT = 0.05
"""m: the support size of a keypoint. The paper does not specify it; at this size half of the objects that stand on a
table have ten keypoints, and the paper scans the ten best regions."""
_PITCH = 0.0015
"""m between neighbouring pixels on the object, that of a Kinect at 0.8 m: a finer image is subsampled by an
integer step, as PCL does for a given resolution."""
_MOST_PIXELS = 100_000
"""Pixels on an object; a larger one is subsampled likewise."""
_SETTLED_PX = 12
"""px around a keypoint's surroundings, so that cropping the image does not change the result."""


def propose(scene: Scene, sensor: Sensor, count: int, rng: np.random.Generator) -> list[ProposedRegion]:
    """Up to `count` regions, one for each keypoint, often fewer; the result does not depend on `rng`."""
    depths, focal_length = scene.depth.metres[scene.mask], min(scene.camera.fx, scene.camera.fy)
    near, middle = (float(np.percentile(depths, q)) for q in (1, 50))
    step = max(1, int(_PITCH * focal_length / near), int(np.ceil(np.sqrt(depths.size / _MOST_PIXELS))))
    view, (u0, v0) = scene.cropped(middle * (SUPPORT / 2 / near + _SETTLED_PX * step / focal_length))
    left, top, right, bottom = view.bounds()
    kept, c = np.s_[::step, ::step], view.camera
    coarse = Camera(c.fx / step, c.fy / step, c.cx / step, c.cy / step)
    found = find_features(DepthImage(view.depth.metres[kept]), coarse, view.mask[kept], SUPPORT)
    regions = [
        make_region(step * pixel, descriptor, pose, c, (right - left) * (bottom - top) / 2)
        for pixel, descriptor, pose in zip(found.pixels, found.descriptors, found.poses, strict=True)
        if np.isfinite(descriptor).all()
    ]
    regions.sort(key=lambda region: -region.confidence)
    return [ProposedRegion(r.rectangle.shifted(u0, v0), r.confidence) for r in regions[:count]]
