"""A view no larger and no finer than the engines have a use for, so that any image that is let in is answered soon."""

from __future__ import annotations

import numpy as np

from pretouch.camera import Camera, DepthImage
from pretouch.scene import Scene

MOST_PIXELS = 150_000
"""Of an image; a larger one is cut to what surrounds the object."""
MOST_OBJECT_PIXELS = 100_000
"""Pixels of the object; of more, every second is kept in each direction, or every third, and so on."""
_AROUND = 0.15
"""m around the object that are kept."""


def coarse(scene: Scene) -> Scene:
    """`scene` itself unless it is larger or finer than needed."""
    if scene.mask.size > MOST_PIXELS:
        scene = scene.cropped(_AROUND)[0]
    step = int(np.ceil(np.sqrt(scene.mask.sum() / MOST_OBJECT_PIXELS)))
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
