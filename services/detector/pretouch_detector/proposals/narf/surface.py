"""The plane through the points around a pixel that lie on the pixel's own surface, not beyond a jump in depth."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from pretouch_detector.proposals.narf.moments import COUNT, MOMENTS, add_point, compute_axes, dot
from pretouch_detector.proposals.narf.order import sort
from pretouch_detector.proposals.narf.range_image import Floats, RangeImage

RADIUS = 2
"""px: half the side of the window, less the pixel itself."""
NEAREST = 9
"""The number of the window's points that are taken to be on the pixel's surface; all up to twice as far are added."""
_SIDE = 2 * RADIUS + 1
_ZERO, _ONE, _FOUR = np.float32(0), np.float32(1), np.float32(4)


class Surface(NamedTuple):
    """Local planes.

    Attributes:
        normals: (h, w, 3) unit, towards the camera; NaN where a plane is not known.
        means: (h, w, 3), m, a point of the plane, in the camera frame.
        reach: (h, w), m^2, squared distance to the ninth nearest point of the window.
    """

    normals: Floats
    means: Floats
    reach: Floats


def fit_surface(image: RangeImage) -> Surface:
    """The local plane of each pixel with data and at least three points on its surface."""
    shape = image.ranges.shape
    found = Surface(
        np.full((*shape, 3), np.nan, np.float32),
        np.full((*shape, 3), np.nan, np.float32),
        np.full(shape, np.nan, np.float32),
    )
    _fit_planes(image.points, image.ranges, found.normals, found.means, found.reach)
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _fit_planes(points: Floats, ranges: Floats, normals: Floats, means: Floats, reach: Floats) -> None:
    h, w = ranges.shape
    for v in range(h):
        for u in range(w):
            if np.isfinite(ranges[v, u]):
                reach[v, u] = fit_plane(points, ranges, v, u, points[v, u], NEAREST, normals[v, u], means[v, u])


@njit(cache=True, nogil=True, error_model="numpy")
def fit_plane(
    points: Floats, ranges: Floats, v: int, u: int, around: Floats, nearest: int, normal: Floats, mean: Floats
) -> np.float32:
    """Fits a plane to the points of the window about pixel (v, u) that are near to `around` (3,), m.

    Writes `normal` (3,), towards the camera, and `mean` (3,), m. Returns the squared distance, m^2, to the `nearest`-th
    point; NaN, nothing written, with fewer than three points.
    """
    h, w = ranges.shape
    distances = np.empty(_SIDE * _SIDE, np.float32)
    pixels = np.empty(_SIDE * _SIDE, np.int64)
    count = 0
    for y in range(max(0, v - RADIUS), min(h, v + RADIUS + 1)):
        for x in range(max(0, u - RADIUS), min(w, u + RADIUS + 1)):
            if np.isfinite(ranges[y, x]):
                distances[count] = compute_square_distance(around, points[y, x])
                pixels[count] = y * w + x
                count += 1
    sort(distances, pixels, count)
    if count < 3:
        return np.float32(np.nan)
    reach = distances[min(nearest, count) - 1]
    moments = np.zeros(MOMENTS, np.float32)
    for k in range(count):
        if distances[k] > reach * _FOUR:
            break
        add_point(moments, points[pixels[k] // w, pixels[k] % w], _ONE)
    if moments[COUNT] < 3:
        return np.float32(np.nan)
    values, vectors = np.empty(3, np.float32), np.empty((3, 3), np.float32)
    compute_axes(moments, values, vectors)
    sign = -_ONE if dot(vectors[0], around) > _ZERO else _ONE
    for k in range(3):
        normal[k] = sign * vectors[0, k]
        mean[k] = moments[k]
    return reach


@njit(cache=True, nogil=True, error_model="numpy")
def compute_square_distance(a: Floats, b: Floats) -> np.float32:
    """m^2, between the points a and b, (3,) each."""
    x, y, z = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    return x * x + y * y + z * z
