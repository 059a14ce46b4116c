"""The NARF descriptor: how the surface falls away from a keypoint along 36 beams in the plane across its normal.

After Steder et al., "Point Feature Extraction on 3D Range Scans Taking into Account Object Boundaries", ICRA 2011,
section V, upright: without the turn to a dominant direction.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch_detector.proposals.narf.patch import CELLS, compute_upright_frame, render_patch
from pretouch_detector.proposals.narf.range_image import Floats, RangeImage

BEAMS = 36
_FINE = 2 * CELLS
_STEPS = CELLS
_FIRST_WEIGHT = np.float32(2)
"""Weight of a beam's first step, as a multiple of its last one's."""
_ZERO, _ONE, _TWO, _HALF = np.float32(0), np.float32(1), np.float32(2), np.float32(0.5)
_DEGREE = np.float32(0.017453293)
_TURN, _STRAIGHT = np.float32(360) * _DEGREE, np.float32(180) * _DEGREE


def describe_keypoints(image: RangeImage, pixels: NDArray[np.int64], support: float) -> tuple[Floats, Floats]:
    """Descriptors and frames of keypoints (n, 2) as (v, u).

    Returns:
        (n, BEAMS) in [-0.5, 0.5]: a beam's mean rise of distance from the camera, near steps counting more, as
        atan2(rise, support / 2) / pi; beam k points up turned clockwise by k x 10 degrees, as the camera sees it.
        (n, 3, 4) `patch_T_camera`: x right, y down, z along the normal away from the camera. NaN both where too few
        points are near.
    """
    values = np.full((len(pixels), BEAMS), np.nan, np.float32)
    poses = np.full((len(pixels), 3, 4), np.nan, np.float32)
    _describe(image.points, image.ranges, image.optics, pixels, np.float32(support), values, poses)
    return values, poses


@njit(cache=True, nogil=True, error_model="numpy")
def _describe(
    points: Floats, ranges: Floats, optics: Floats, pixels: NDArray[np.int64], support: np.float32, values: Floats,
    poses: Floats,
) -> None:  # fmt: skip
    for n in range(len(pixels)):
        if compute_upright_frame(points, ranges, pixels[n, 0], pixels[n, 1], support, poses[n]):
            patch = _blur(render_patch(points, ranges, optics, poses[n], support), support)
            _sample_beams(patch, support, values[n])


@njit(cache=True, nogil=True, error_model="numpy")
def _blur(patch: Floats, support: np.float32) -> Floats:
    """(2 CELLS, 2 CELLS): the patch at twice its resolution, averaged over 3 x 3 cells; unknown is far away."""
    sums = np.zeros((_FINE + 1, _FINE + 1), np.float32)
    for row in range(_FINE):
        for column in range(_FINE):
            value = patch[row // 2, column // 2]
            if np.isinf(value):
                value = _HALF * support
            sums[row + 1, column + 1] = value + (sums[row + 1, column] + sums[row, column + 1] - sums[row, column])
    blurred = np.empty((_FINE, _FINE), np.float32)
    for row in range(_FINE):
        for column in range(_FINE):
            top, bottom = max(0, row - 1), min(_FINE, row + 2)
            left, right = max(0, column - 1), min(_FINE, column + 2)
            share = _ONE / np.float32((bottom - top) * (right - left))
            blurred[row, column] = share * (
                sums[bottom, right] + sums[top, left] - sums[bottom, left] - sums[top, right]
            )
    return blurred


@njit(cache=True, nogil=True, error_model="numpy")
def _sample_beams(patch: Floats, support: np.float32, values: Floats) -> None:
    last = np.float32(_STEPS - 1)
    slope = -_TWO * (_FIRST_WEIGHT - _ONE) / ((_FIRST_WEIGHT + _ONE) * last)
    most = _TWO * _FIRST_WEIGHT / (_FIRST_WEIGHT + _ONE)
    size = support / np.float32(_FINE)
    per_cell, middle = _ONE / size, _HALF * (support - size)
    reach = _HALF * support
    pace = (reach - _HALF * size) / np.float32(_STEPS)
    for beam in range(BEAMS):
        angle = np.float32(beam) * (_TURN / np.float32(BEAMS))
        x, y = np.sin(angle) * pace, -np.cos(angle) * pace
        rise, before = _ZERO, _ZERO
        for step in range(_STEPS + 1):
            column = int(np.rint(per_cell * (x * np.float32(step) + middle)))
            row = int(np.rint(per_cell * (y * np.float32(step) + middle)))
            here = patch[row, column]
            if step > 0:
                rise += (slope * np.float32(step - 1) + most) * (here - before)
            before = here
        values[beam] = np.arctan2(rise, reach) / _STRAIGHT
