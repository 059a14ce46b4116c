"""How low the fingertip may go: the believed surface, widened and raised by what the estimate leaves uncertain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from pretouch.estimate import Estimate
from pretouch.geometry import Array
from pretouch_orchestrator.perception.heightmap import HeightMap
from pretouch_orchestrator.perception.table import table_covariance

FINGER_RADIUS = 0.010
"""m around the beam that the finger takes up."""
_DISC_STEPS = 6


@dataclass(frozen=True)
class Margins:
    """What is kept between the fingertip and what may lie under it, in standard deviations of the estimate.

    Over all places of a scan at once, the table's three degrees of freedom exceed 4 standard deviations upwards with at
    most P(chi2_3 > 16) / 2 = 0.06 %, and sideways with P(chi2_2 > 16) = 0.03 %: 0.1 % together.

    Attributes:
        sigmas: the standoff is kept from whatever may come under the finger within this many to a side.
        safe_sigmas: `closest` is kept up to this many, upwards and to a side.
        closest: m from object or table that the tip does not come within.
    """

    sigmas: float = 3.0
    safe_sigmas: float = 4.0
    closest: float = 0.005


SAFE = Margins()
"""The tip comes closer than 5 mm in at most one scan of a thousand."""


def vertical_std(covariance: Array, x: Array, y: Array) -> Array:
    """m: how far up or down a point at (x, y), m, from the centroid may be; covariance in the table's axes.

    An error (w, d) lifts the point by d_z + w_x y - w_y x.
    """
    x, y = np.broadcast_arrays(x, y)
    lift = np.stack([y, -x, np.zeros_like(x), np.zeros_like(x), np.zeros_like(x), np.ones_like(x)], axis=-1)
    return np.asarray(np.sqrt(np.maximum(((lift @ covariance) * lift).sum(axis=-1), 0.0)), dtype=np.float64)


def lateral_std(covariance: Array, arms: Array) -> float:
    """m: how far to the worst side the worst of points with `arms` (n, 3), m, from the centroid may be.

    An error (w, d) shifts a point sideways by (d_x + w_y z - w_z y, d_y + w_z x - w_x z).
    """
    x, y, z = arms.T
    o, i = np.zeros_like(x), np.ones_like(x)
    shift = np.stack([np.stack([o, z, -y, i, o, o], axis=-1), np.stack([-z, o, x, o, i, o], axis=-1)], axis=1)
    largest = np.linalg.eigvalsh(shift @ covariance @ shift.swapaxes(1, 2))[:, -1].max()
    return float(np.sqrt(max(largest, 0.0)))


def reach_of(lateral: float, margins: Margins = SAFE) -> float:
    """m: how far around the beam the surface counts when a point may be `lateral` m, one sigma, to a side."""
    return max(FINGER_RADIUS + margins.sigmas * lateral, margins.closest + margins.safe_sigmas * lateral)


def lowest_tip(
    height_map: HeightMap, estimate: Estimate, reach: float, standoff: float, margins: Margins = SAFE
) -> Array:
    """The lowest allowed height of the tip, (nx, ny), m in the table's frame, over each cell of the map.

    It is at least `standoff` above the highest believed point within `reach` m, and at least `margins.closest` above it
    plus `margins.safe_sigmas` standard deviations of that point's height. No more than that: what lies lower than the
    highest point near it must stay within the sensor's range.
    """
    covariance = table_covariance(height_map.base_T_table, estimate)
    x, y = height_map.places()
    cx, cy, _ = height_map.base_T_table.inverse().apply(estimate.centroid)
    sigma = vertical_std(covariance, x - cx, y - cy)
    tip = height_map.believed + np.maximum(standoff, margins.closest + margins.safe_sigmas * sigma)
    return _highest_within(tip, reach / height_map.cell)


def _highest_within(values: Array, radius: float) -> Array:
    """The maximum over a disc of `radius` cells or slightly more: over the boxes that together just cover the disc."""
    highest = values
    angles = np.linspace(0.0, np.pi / 2, _DISC_STEPS + 1)
    for cosine, sine in zip(np.cos(angles[:-1]), np.sin(angles[1:]), strict=True):
        size = [2 * int(np.ceil(radius * side)) + 1 for side in (cosine, sine)]
        highest = np.maximum(highest, ndimage.maximum_filter(values, size=size, mode="nearest"))
    return highest
