"""Crops and downsamples a scene, so that time and memory of a registration do not grow with the image."""

from __future__ import annotations

import numpy as np

from pretouch.errors import InvalidInput
from pretouch.scene import Scene

MAX_UNCROPPED = 150_000
"""Pixels of an image; a larger one is cropped around the object."""
MAX_PIXELS = 400_000
"""Pixels of a cropped image. With more, every second pixel in each direction is kept, or every third, and so on: of an
object in its margin they are then still less than half a millimetre apart."""
MAX_OBJECT_PIXELS = 100_000
"""Of the object; likewise."""
MAX_OBJECT_SIZE = 2.0
"""m, along the table's axes: the model's cells are 3 mm wide however large the object is."""
_MARGIN = 0.15
"""m around the object that a crop keeps."""


def downsample_scene(scene: Scene) -> Scene:
    """The scene within the limits above; `scene` itself if it already is.

    Raises:
        InvalidInput: the object is larger than any that stands on a table.
    """
    if scene.mask.size > MAX_UNCROPPED:
        scene = scene.cropped(_MARGIN)[0]
    ratio = max(scene.mask.size / MAX_PIXELS, scene.mask.sum() / MAX_OBJECT_PIXELS)
    scene = scene.subsampled(max(1, int(np.ceil(np.sqrt(ratio)))))
    size = float(np.ptp(scene.cloud @ scene.table.frame().rotation, axis=0).max())
    if size > MAX_OBJECT_SIZE:
        raise InvalidInput(
            f"The object is {size:.4g} m large; the limit is {MAX_OBJECT_SIZE:g} m.",
            "Check the depth's unit, and that the mask holds the object alone.",
        )
    return scene
