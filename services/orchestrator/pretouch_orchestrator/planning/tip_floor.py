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


@dataclass(frozen=True)
class Margins:
    """The distance between the fingertip and the surface, in standard deviations of the estimate.

    Over a whole scan, the table's three degrees of freedom exceed 4 standard deviations upwards with a probability of
    at most P(chi2_3 > 16) / 2 = 0.06 %, and sideways of P(chi2_2 > 16) = 0.03 %: 0.1 % together.

    Attributes:
        sigmas: the standoff holds for lateral errors of up to this many standard deviations.
        safe_sigmas: `closest` holds for vertical and lateral errors of up to this many.
        closest: m, the smallest distance from object or table.
    """

    sigmas: float = 3.0
    safe_sigmas: float = 4.0
    closest: float = 0.005


SAFE = Margins()
"""The tip comes closer than 5 mm in at most one scan of a thousand."""


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
    return max(FINGER_RADIUS + margins.sigmas * lateral, margins.closest + margins.safe_sigmas * lateral)


def compute_tip_floor(
    height_map: HeightMap, estimate: Estimate, reach: float, standoff: float, margins: Margins = SAFE
) -> Array:
    """The lowest allowed height of the tip, (nx, ny), m in the table's frame, over each cell of the map.

    It is the maximum over the believed points within `reach` m of their height plus either `standoff`, or
    `margins.closest` and `margins.safe_sigmas` standard deviations of that height, whichever is more. It is no higher
    than that, so that points lower than the highest one nearby stay within the sensor's range.
    """
    covariance = table_covariance(height_map.base_T_table, estimate)
    x, y = height_map.places()
    cx, cy, _ = height_map.base_T_table.inverse().apply(estimate.centroid)
    sigma = vertical_std(covariance, x - cx, y - cy)
    tip = height_map.believed + np.maximum(standoff, margins.closest + margins.safe_sigmas * sigma)
    return _dilate(tip, reach / height_map.cell)


def _dilate(values: Array, radius: float) -> Array:
    """The maximum over a disc of `radius` cells, approximated from outside by boxes that together cover it."""
    highest = values
    angles = np.linspace(0.0, np.pi / 2, _DISC_BOXES + 1)
    for cosine, sine in zip(np.cos(angles[:-1]), np.sin(angles[1:]), strict=True):
        size = [2 * int(np.ceil(radius * side)) + 1 for side in (cosine, sine)]
        highest = np.maximum(highest, ndimage.maximum_filter(values, size=size, mode="nearest"))
    return highest
