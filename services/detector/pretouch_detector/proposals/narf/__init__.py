"""Proposer `narf`: the regions that Lancaster et al. 2017 compare their network with.

A rectangle about each NARF keypoint of the object, turned and shaped by the keypoint's descriptor; after Steder, Rusu,
Konolige, Burgard, "Point Feature Extraction on 3D Range Scans Taking into Account Object Boundaries", ICRA 2011. The
borders, the complete interest image, keypoints and descriptors are those of PCL 1.13, to the bit.
"""

from __future__ import annotations

import numpy as np

from pretouch.camera import Camera, DepthImage
from pretouch.geometry import Plane, Pose
from pretouch.scene import Scene
from pretouch.tof import Sensor
from pretouch_detector.proposals.region import ProposedRegion

SUPPORT = 0.05
"""m: how large a keypoint's surroundings are. The paper does not say; at this size half of the objects that stand on a
table have ten keypoints, and the paper scans the ten best regions."""
_SETTLED_PX = 12
"""px around what a keypoint's surroundings cover, so that cropping the image does not change it."""


def propose(scene: Scene, sensor: Sensor, count: int, rng: np.random.Generator) -> list[ProposedRegion]:
    """Up to `count` regions, one for each keypoint and so often fewer; nothing in them is left to chance."""
    from pretouch_detector.proposals.narf.features import features  # here, since numba takes a second to import
    from pretouch_detector.proposals.narf.rectangles import region

    depths = scene.depth.metres[scene.mask]
    middle, focal_length = float(np.median(depths)), min(scene.camera.fx, scene.camera.fy)
    margin = middle * (SUPPORT / 2 / float(depths.min()) + _SETTLED_PX / focal_length)
    view, (u0, v0) = scene.cropped(margin)
    left, top, right, bottom = view.bounds()
    found = features(view.depth, view.camera, view.mask, SUPPORT)
    regions = [
        region(pixel, descriptor, pose, view.camera, (right - left) * (bottom - top) / 2)
        for pixel, descriptor, pose in zip(found.pixels, found.descriptors, found.poses, strict=True)
        if np.isfinite(descriptor).all()
    ]
    regions.sort(key=lambda region: -region.confidence)
    return [ProposedRegion(r.rectangle.shifted(u0, v0), r.confidence) for r in regions[:count]]


def warm_up() -> None:
    """Compiles or loads all that a request needs."""
    depth = np.ones((24, 24), np.float32)
    mask = np.zeros(depth.shape, np.bool_)
    mask[8:16, 8:16] = True
    camera, table = Camera(500.0, 500.0, 11.5, 11.5), Plane(np.array([0.0, 0.0, 1.0]), 0.0)
    scene = Scene(DepthImage(depth), camera, Pose.identity(), mask, table)
    propose(scene, Sensor(), 1, np.random.default_rng(0))
