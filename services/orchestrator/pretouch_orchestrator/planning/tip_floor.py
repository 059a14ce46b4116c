"""The lowest allowed height of the fingertip: the believed surface, dilated and raised by the pose uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from pretouch.estimate import Estimate
from pretouch.geometry import Array
from pretouch_orchestrator.perception.heightmap import HeightMap
from pretouch_orchestrator.perception.table import table_covariance

FINGER_RADIUS = 0.010
"""m: how far the finger extends around the beam."""
_DISC_BOXES = 6
_ROUNDING = 2.0
"""Cells that a reach grows by, since places and points are rounded to cells."""


@dataclass(frozen=True)
class Margins:
    """The distance between the fingertip and the surface, in standard deviations of the estimate.

    Over a whole scan, the table's three degrees of freedom exceed 4 standard deviations upwards with a probability of
    at most P(chi2_3 > 16) / 2 = 0.06 %, and sideways of P(chi2_2 > 16) = 0.03 %: 0.1 % together.

    Attributes:
        sigmas: the standoff holds for lateral errors of up to this many standard deviations.
        safe_sigmas: `closest` holds for vertical and lateral errors of up to this many.
        closest: m, the smallest distance from object or table.
        side_sigmas: the tip is higher than anything in the finger's way, by what `closest` and `safe_sigmas` ask for,
            for lateral errors of up to this many. What stands beside the finger is in no beam.
    """

    sigmas: float = 3.0
    safe_sigmas: float = 4.0
    closest: float = 0.005
    side_sigmas: float = 2.5


SAFE = Margins()
"""The tip comes closer than 5 mm in at most one scan of a thousand."""
GUARDED = Margins(sigmas=1.0, safe_sigmas=1.0, closest=0.010)
"""From what is expected, for a robot whose own reflex lifts the tip while a range is below 10 mm.

The reflex sees nothing of what stands beside the finger: for that, lateral errors of up to 2.5 standard deviations
count, which are exceeded towards one side with a probability of 0.6 %.
"""


def vertical_std(covariance: Array, x: Array, y: Array) -> Array:
    """m: standard deviation of the height of points at (x, y), m, from the centroid; covariance in the table's axes.

    An error (w, d) lifts the point by d_z + w_x y - w_y x.
    """
    x, y = np.broadcast_arrays(x, y)
    lift = np.stack([y, -x, np.zeros_like(x), np.zeros_like(x), np.zeros_like(x), np.ones_like(x)], axis=-1)
    return np.asarray(np.sqrt(np.maximum(((lift @ covariance) * lift).sum(axis=-1), 0.0)), dtype=np.float64)


def lateral_std(covariance: Array, arms: Array) -> float:
    """m: largest lateral standard deviation of points at `arms` (n, 3), m, from the centroid, in the worst direction.

    An error (w, d) shifts a point sideways by (d_x + w_y z - w_z y, d_y + w_z x - w_x z).
    """
    x, y, z = arms.T
    o, i = np.zeros_like(x), np.ones_like(x)
    shift = np.stack([np.stack([o, z, -y, i, o, o], axis=-1), np.stack([-z, o, x, o, i, o], axis=-1)], axis=1)
    largest = np.linalg.eigvalsh(shift @ covariance @ shift.swapaxes(1, 2))[:, -1].max()
    return float(np.sqrt(max(largest, 0.0)))


def compute_reach(lateral: float, margins: Margins = SAFE) -> float:
    """m around the beam within which the surface counts if its lateral standard deviation is `lateral` m."""
    return max(_compute_near_reach(lateral, margins), _compute_side_reach(lateral, margins))


def _compute_near_reach(lateral: float, margins: Margins) -> float:
    return max(FINGER_RADIUS + margins.sigmas * lateral, margins.closest + margins.safe_sigmas * lateral)


def _compute_side_reach(lateral: float, margins: Margins) -> float:
    return FINGER_RADIUS + margins.side_sigmas * lateral


def compute_tip_floor(
    height_map: HeightMap, estimate: Estimate, lateral: float, standoff: float, margins: Margins = SAFE
) -> Array:
    """The lowest allowed height of the tip, (nx, ny), m in the table's frame, over each cell of the map.

    It is the maximum over the believed points nearby of their height plus either `standoff`, or `margins.closest` and
    `margins.safe_sigmas` standard deviations of that height, whichever is more; of points that only a lateral error of
    `margins.side_sigmas` brings into the finger's way, without `standoff`. It is no higher than that, so that points
    lower than the highest one nearby stay within the sensor's range.

    Args:
        lateral: m, the surface's lateral standard deviation.
    """
    covariance = table_covariance(height_map.base_T_table, estimate)
    x, y = height_map.places()
    cx, cy, _ = height_map.base_T_table.inverse().apply(estimate.centroid)
    above = margins.closest + margins.safe_sigmas * vertical_std(covariance, x - cx, y - cy)
    near, side = _compute_near_reach(lateral, margins), _compute_side_reach(lateral, margins)
    cell = height_map.cell
    floor = _dilate(height_map.believed + np.maximum(standoff, above), near / cell + _ROUNDING)
    if side > near:
        floor = np.maximum(floor, _dilate(height_map.believed + above, side / cell + _ROUNDING))
    return floor


def _dilate(values: Array, radius: float) -> Array:
    """The maximum over a disc of `radius` cells, approximated from outside by boxes that together cover it."""
    highest = values
    angles = np.linspace(0.0, np.pi / 2, _DISC_BOXES + 1)
    for cosine, sine in zip(np.cos(angles[:-1]), np.sin(angles[1:]), strict=True):
        size = [2 * int(np.ceil(radius * side)) + 1 for side in (cosine, sine)]
        highest = np.maximum(highest, ndimage.maximum_filter(values, size=size, mode="nearest"))
    return highest
