"""A height map of the view, as beams along the table's normal hit it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pretouch.geometry import Array
from pretouch.scene import TABLE_BAND, Scene
from pretouch_detector.proposals.from_above import Grid, project_from_above

AROUND = 0.05
"""m of table around the object that are mapped."""
_CELL = 0.003
_MAX_CELLS = 160
"""Along one side; a larger object gets larger cells."""
_MOST_PIXELS = 100_000
"""A larger view is subsampled by an integer step."""
_CLOSING = 2
"""Cells: narrower gaps between pixels' points are closed."""


@dataclass(frozen=True, eq=False)
class Relief:
    """Heights above the table over a grid of its plane; places are in the table's frame, the object's centroid at 0.

    Attributes:
        grid: the cells of `height`, `known` and `away`.
        height: (nx, ny), m: of the object's highest point there; 0 where none was seen.
        known: (nx, ny): the camera saw object or table there.
        away: (nx, ny), m, over the ground, from the object.
        centre_height: m, the centroid's height above the table.
        places: (h, w, 2), m: what lies at each pixel of the view, seen from above; NaN where neither object nor table.
        first, step: the view's pixel (u, v) that `places[0, 0]` is of, and how many pixels apart its entries are.
        spread: (3, 3), m^2, second moment of the object's points about their centroid.
    """

    grid: Grid
    height: Array
    known: NDArray[np.bool_]
    away: Array
    centre_height: float
    places: Array
    first: tuple[int, int]
    step: int
    spread: Array


def map_relief(scene: Scene) -> Relief:
    """What the camera saw within AROUND of the object."""
    table_T_base = scene.table.frame().inverse()
    body = table_T_base.apply(scene.cloud)
    centroid = body.mean(axis=0)
    arms = body - centroid
    corner, end = arms[:, :2].min(axis=0) - AROUND, arms[:, :2].max(axis=0) + AROUND
    cell = max(_CELL, float((end - corner).max()) / (_MAX_CELLS - 1))
    nx, ny = (np.ceil((end - corner) / cell).astype(int) + 1).tolist()

    near, first = scene.cropped(AROUND)
    step = int(np.ceil(np.sqrt(near.mask.size / _MOST_PIXELS)))
    depth, mask = near.depth.metres[::step, ::step].copy(), near.mask[::step, ::step].copy()
    c = near.camera
    camera = np.array([c.fx, c.fy, c.cx, c.cy]) / step
    table_T_camera = table_T_base @ scene.base_T_camera
    shift = table_T_camera.translation - (centroid[0], centroid[1], 0.0)
    grid = Grid(corner, cell, (nx, ny))
    places, top, ground = project_from_above(depth, mask, camera, table_T_camera.rotation, shift, TABLE_BAND, grid)
    on = ndimage.binary_closing(np.isfinite(top), iterations=_CLOSING)
    return Relief(
        grid=grid,
        height=_fill_gaps(top, on),
        known=on | ndimage.binary_closing(np.isfinite(ground), iterations=_CLOSING),
        away=np.asarray(ndimage.distance_transform_edt(~on) * cell, dtype=np.float64),
        centre_height=float(centroid[2]),
        places=places,
        first=first,
        step=step,
        spread=arms.T @ arms / len(arms),
    )


def _fill_gaps(top: Array, on: NDArray[np.bool_]) -> Array:
    """`top` (nx, ny), at least 0; in gaps that are `on` the object, its neighbours' mean; elsewhere 0."""
    seen = np.isfinite(top)
    heights = np.where(seen, np.maximum(top, 0.0), 0.0)
    share = ndimage.gaussian_filter(seen.astype(np.float64), 1.0)
    around = ndimage.gaussian_filter(heights, 1.0) / np.maximum(share, 1e-3)
    return np.asarray(np.where(seen, heights, np.where(on, around, 0.0)), dtype=np.float64)
