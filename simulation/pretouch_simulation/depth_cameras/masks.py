"""The client's mask of an object: it comes from another source than the depth, so that it is misaligned."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pretouch_simulation.depth_cameras.fields import smooth_field

_MARGIN = 8
"""px around the reach of the outline; the rest of the image is not processed."""


@dataclass(frozen=True)
class Outline:
    """How far the mask's outline is from the true one, standard deviations in px of the camera's own image.

    Attributes:
        growth: of the whole outline, outwards; drawn once an image.
        shift: of the whole mask along each axis; drawn once an image.
        wander: along the outline, smooth over `scale` px.
    """

    growth: float
    shift: float
    wander: float
    scale: float


ASSUMED_OUTLINE = Outline(growth=0.8, shift=0.8, wander=1.2, scale=15.0)
"""An assumption: no data tells how far a client's segmentation is off."""


def distort_outline(
    mask: NDArray[np.bool_], outline: Outline, zoom: float, rng: np.random.Generator
) -> NDArray[np.bool_]:
    """The mask (h, w) with its outline moved from the true one; `zoom`: image px to one of the camera's own."""
    growth = zoom * outline.growth * rng.standard_normal()
    shift = zoom * outline.shift * rng.standard_normal(2)
    wander = zoom * outline.wander * smooth_field(rng, mask.shape, zoom * outline.scale)
    if not mask.any():
        return mask.copy()
    reach = int(np.abs(growth) + np.abs(shift).max() + np.abs(wander).max()) + _MARGIN
    (top, bottom), (left, right) = (
        (max(int(there[0]) - reach, 0), int(there[-1]) + reach + 1)
        for there in (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    )
    window = slice(top, bottom), slice(left, right)
    part = np.pad(mask[window], _MARGIN)
    inside = ndimage.distance_transform_edt(part) - ndimage.distance_transform_edt(~part)
    moved = ndimage.shift(inside, shift, order=1, mode="nearest")[_MARGIN:-_MARGIN, _MARGIN:-_MARGIN]
    found = np.zeros_like(mask)
    found[window] = moved + growth + wander[window] > 0
    return found
