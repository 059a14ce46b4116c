"""Crops and downsamples a scene, so that the time of a registration does not grow with the image."""

from __future__ import annotations

import numpy as np

from pretouch.camera import Camera, DepthImage
from pretouch.scene import Scene

MAX_PIXELS = 150_000
"""Of an image; a larger one is cropped around the object."""
MAX_OBJECT_PIXELS = 100_000
"""Of the object; with more, every second pixel in each direction is kept, or every third, and so on."""
_MARGIN = 0.15
"""m around the object that a crop keeps."""


def downsample_scene(scene: Scene) -> Scene:
    """The scene within the limits above; `scene` itself if it already is."""
    if scene.mask.size > MAX_PIXELS:
        scene = scene.cropped(_MARGIN)[0]
    step = int(np.ceil(np.sqrt(scene.mask.sum() / MAX_OBJECT_PIXELS)))
    if step <= 1:
        return scene
    c = scene.camera
    return Scene(
        DepthImage(scene.depth.metres[::step, ::step]),
        Camera(c.fx / step, c.fy / step, c.cx / step, c.cy / step),
        scene.base_T_camera,
        scene.mask[::step, ::step],
        scene.table,
    )
