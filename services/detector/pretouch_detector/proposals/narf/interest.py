"""How interesting a pixel is: strong surface changes of different directions nearby, but not too near.

After Steder et al., "Point Feature Extraction on 3D Range Scans Taking into Account Object Boundaries", ICRA 2011,
section IV, as PCL computes its complete interest image.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch_detector.proposals.narf.change import Change
from pretouch_detector.proposals.narf.range_image import Floats, RangeImage

BINS = 18
"""Bins of the histogram of directions over half a turn."""
LEAST_CHANGE = np.float32(0.2)
_STABLE_DISTANCE = np.float32(0.25)
"""As a share of half the support size: a surface change nearer than this makes a point unstable."""
ALWAYS_PX, FULL_PX = 2, 1
"""px; pixels this near belong to a pixel's surroundings whatever their depth, and count with their full score."""
_NEVER = np.iinfo(np.int32).max
_ZERO, _ONE, _TWO, _HALF = np.float32(0), np.float32(1), np.float32(2), np.float32(0.5)
_PI, _DEGREE = np.float32(np.pi), np.float32(0.017453293)
_RIGHT, _STRAIGHT = np.float32(90) * _DEGREE, np.float32(180) * _DEGREE


def compute_interest(
    image: RangeImage, change: Change, hidden: NDArray[np.bool_], where: NDArray[np.bool_], support: float
) -> Floats:
    """(h, w) in [0, 1], of the pixels `where` (h, w); 0 elsewhere and on `hidden` ones (shadow borders, veil points).

    Args:
        support: m, the size of a keypoint's surroundings.
    """
    h, w = image.ranges.shape
    framed = np.full((7, h + 2, w + 2), np.nan, np.float32)
    inner = framed[:, 1:-1, 1:-1]
    inner[:3] = np.where(hidden, np.float32(np.nan), np.moveaxis(image.points, -1, 0))
    inner[3], inner[4:] = change.scores, np.moveaxis(change.directions, -1, 0)
    centres = np.flatnonzero(np.pad(where & np.isfinite(image.ranges) & ~hidden, 1))
    values = np.zeros((h + 2) * (w + 2), np.float32)
    _fill_interest(np.moveaxis(framed, 0, -1).reshape(-1, 7), centres, w + 2, np.float32(support), values)
    return np.ascontiguousarray(values.reshape(h + 2, w + 2)[1:-1, 1:-1])


@njit(cache=True, nogil=True, error_model="numpy")
def _fill_interest(pixels: Floats, centres: NDArray[np.int64], width: int, support: np.float32, values: Floats) -> None:
    """The interest of the pixels `centres` (n,), each from those connected to it within half of `support`.

    `pixels` (k, 7) are rows of `width` framed by ones that are not to be entered: point (NaN: not to be entered), score
    and direction of the change.
    """
    radius = _HALF * support
    square_radius, inverse_radius = radius * radius, _ONE / radius
    around = np.array([-width - 1, -width, -width + 1, -1, 1, width - 1, width, width + 1])
    far = ALWAYS_PX * (width + 1)
    pixels_away = np.full(2 * far + 1, ALWAYS_PX + 1)
    for dv in range(-ALWAYS_PX, ALWAYS_PX + 1):
        for du in range(-ALWAYS_PX, ALWAYS_PX + 1):
            pixels_away[dv * width + du + far] = max(abs(dv), abs(du))
    reached = np.where(np.isnan(pixels[:, 0]), _NEVER, -1).astype(np.int32)
    queue = np.empty(len(pixels), np.int32)
    bins = np.empty(BINS, np.float32)
    frame = np.empty(6, np.float32)
    for centre in centres:
        px, py, pz = pixels[centre, 0], pixels[centre, 1], pixels[centre, 2]
        compute_image_axes(px, py, pz, frame)
        bins[:] = _ZERO
        weakest, steady = _ZERO, _ONE
        first, last = 0, 1
        queue[0] = reached[centre] = centre
        while first < last:
            k = np.int64(queue[first])
            first += 1
            ex, ey, ez = pixels[k, 0] - px, pixels[k, 1] - py, pixels[k, 2] - pz
            square = ex * ex + ey * ey + ez * ez
            away = far + 1 if abs(k - centre) > far else pixels_away[k - centre + far]
            if square > square_radius and away > ALWAYS_PX:
                continue
            for step in around:
                if reached[k + step] < centre:
                    reached[k + step] = centre
                    queue[last] = k + step
                    last += 1
            score = pixels[k, 3]
            if score < LEAST_CHANGE:
                continue
            near = inverse_radius * np.sqrt(square)
            unsteady = _ONE - _HALF * score * max(_ONE - near / _STABLE_DISTANCE, _ZERO)
            steady = min(steady, unsteady * unsteady)
            strength = score if away <= FULL_PX else score * (_ONE - near)
            if strength > weakest:
                cell = find_bin(pixels[k, 4:7], frame)
                if strength > bins[cell]:
                    bins[cell] = strength
                    weakest = bins.min()
        values[centre] = steady * _score_variety(bins)


@njit(cache=True, nogil=True, error_model="numpy")
def compute_image_axes(x: np.float32, y: np.float32, z: np.float32, frame: Floats) -> None:
    """Writes the axes left and up, across the ray to a point and in the camera frame, to `frame` (6,)."""
    length = np.sqrt(x * x + (y * y + z * z))
    x, y, z = x / length, y / length, z / length
    length = np.sqrt(z * z + x * x)
    ax, az = -z / length, x / length
    bx, by, bz = y * az, z * ax - x * az, -(y * ax)
    length = np.sqrt(bx * bx + (by * by + bz * bz))
    frame[0], frame[1], frame[2] = ax, _ZERO, az
    frame[3], frame[4], frame[5] = bx / length, by / length, bz / length


@njit(cache=True, nogil=True, error_model="numpy")
def find_bin(direction: Floats, frame: Floats) -> int:
    """The bin of a direction (3,) as seen along the ray whose axes by `compute_image_axes` are `frame` (6,).

    PCL computes the angle from its cosine alone: directions that mirror each other at the image's u axis share a bin.
    """
    across = frame[0] * direction[0] + frame[1] * direction[1] + frame[2] * direction[2]
    along = frame[3] * direction[0] + frame[4] * direction[1] + frame[5] * direction[2]
    length = np.sqrt(across * across + along * along)
    turned = _TWO * np.arccos(across / length if length > _ZERO else across)
    angle = _HALF * (np.fmod(turned + _PI, _TWO * _PI) - _PI)
    return min(BINS - 1, int(np.floor((angle + _RIGHT) / _STRAIGHT * np.float32(BINS))))


@njit(cache=True, nogil=True, error_model="numpy")
def _score_variety(bins: Floats) -> np.float32:
    """In [0, 1]: the two strongest changes whose directions differ most."""
    best = _ZERO
    for a in range(BINS - 1):
        if bins[a] == _ZERO:
            continue
        for b in range(a + 1, BINS):
            best = max(best, bins[a] * bins[b] * compare_bins(b - a))
    return np.sqrt(best)


@njit(cache=True, nogil=True, error_model="numpy")
def compare_bins(difference: int) -> np.float32:
    """In [0, 1]: how different the directions of two bins are, `difference` bins from each other."""
    share = _TWO * np.float32(difference) / np.float32(BINS)
    return min(share, _TWO - share)
