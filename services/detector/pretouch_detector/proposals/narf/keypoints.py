"""Keypoints: maxima of the interest image with a least distance between them (non-maximum suppression)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pretouch_detector.proposals.narf.order import sort
from pretouch_detector.proposals.narf.range_image import Floats

MIN_INTEREST = np.float32(0.45)
_APART = np.float32(0.25)
"""The least distance between keypoints, as a share of the support size."""


def find_keypoints(interest: Floats, points: Floats, support: float) -> NDArray[np.int64]:
    """(n, 2) pixels as (v, u), the most interesting first.

    Args:
        interest: (h, w).
        points: (h, w, 3), m.
        support: m.
    """
    peaks = (interest >= MIN_INTEREST) & (interest >= ndimage.maximum_filter(interest, size=3))
    pixels = np.argwhere(peaks)
    order = np.arange(len(pixels))
    sort(-interest[peaks], order, len(order))
    pixels = pixels[order]
    least = np.square(_APART * np.float32(support))
    kept: list[int] = []
    places = points[pixels[:, 0], pixels[:, 1]]
    for k, place in enumerate(places):
        if (((places[kept] - place) ** 2).sum(axis=1) >= least).all():
            kept.append(k)
    return pixels[kept]
