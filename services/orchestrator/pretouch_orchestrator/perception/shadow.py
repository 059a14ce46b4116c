"""Upper bounds of what the camera cannot see: behind occluding surfaces and in the depth image's holes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pretouch.geometry import Array

_SIDES = ((0, -1), (0, 1), (1, -1), (1, 1))


def compute_shadow_ceiling(heights: Array, cell: float, camera: Array) -> Array:
    """The height at each cell below which the surfaces nearer to the camera hide everything.

    Along each ray in the table's plane from the point below the camera, the lowest line of sight that clears all
    heights so far (the horizon) bounds what lies behind them: at distance r its height is
    camera z - r min (camera z - height) / distance.

    Args:
        heights: (nx, ny), m, at x = i cell, y = j cell.
        cell: m.
        camera: (3,), m, the camera's position relative to cell (0, 0) at height 0.

    Returns:
        (nx, ny), m; may be negative where nothing is hidden; never above the maximum of `heights`.
    """
    nx, ny = heights.shape
    i, j = np.indices(heights.shape)
    x, y = i * cell - camera[0], j * cell - camera[1]
    away = np.hypot(x, y)
    middle = np.arctan2(y[nx // 2, ny // 2], x[nx // 2, ny // 2])
    bearing = (np.arctan2(y, x) - middle + np.pi) % (2 * np.pi) - np.pi
    step_r, near = 0.7 * cell, float(max(away.min(), cell))
    step_b = 0.7 * cell / float(max(away.max(), cell))
    bearings = np.arange(bearing.min(), bearing.max() + step_b, step_b)
    radii = np.arange(near, away.max() + step_r, step_r)
    u = np.round((camera[0] + radii * np.cos(bearings + middle)[:, None]) / cell).astype(np.intp)
    v = np.round((camera[1] + radii * np.sin(bearings + middle)[:, None]) / cell).astype(np.intp)
    inside = (u >= 0) & (u < nx) & (v >= 0) & (v < ny)
    tops = np.where(inside, heights[u.clip(0, nx - 1), v.clip(0, ny - 1)], -np.inf)
    slopes = np.minimum.accumulate((camera[2] - tops) / radii, axis=1)
    row = ((bearing - bearings[0]) / step_b).astype(np.intp)
    column = np.clip(((away - near) / step_r).astype(np.intp), 0, len(radii) - 1)
    ceiling = np.full(heights.shape, -np.inf)
    for next_row in (0, 1):
        slope = slopes[np.minimum(row + next_row, len(bearings) - 1), column]
        ceiling = np.maximum(ceiling, np.where(np.isfinite(slope), camera[2] - away * slope, -np.inf))
    return np.asarray(np.minimum(ceiling, heights.max()), dtype=np.float64)


def fill_holes(points: Array, seen: NDArray[np.bool_], camera: Array) -> Array:
    """Points for the pixels without depth: on their rays, as high as the highest of the nearest pixels with depth.

    This assumes that nothing in a hole is higher than the nearest pixels to its left and right, above and below.

    Args:
        points: (h, w, 3), m, z up from the table; at pixels that are not `seen`, any point on the pixel's ray.
        seen: (h, w): the pixels with depth.
        camera: (3,), m.

    Returns:
        (m, 3), m, without the pixels whose rays do not reach that height in front of the camera.
    """
    highest = np.full(seen.shape, -np.inf)
    heights = np.where(seen, points[..., 2], -np.inf)
    for axis, way in _SIDES:
        turned = np.moveaxis(heights, axis, 1)[:, ::way]
        known = np.maximum.accumulate(np.where(np.isfinite(turned), np.arange(turned.shape[1]), 0), axis=1)
        nearest = np.moveaxis(np.take_along_axis(turned, known, axis=1)[:, ::way], 1, axis)
        highest = np.maximum(highest, nearest)
    rays = points[~seen] - camera
    level = highest[~seen]
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (level - camera[2]) / rays[:, 2]
    sound = np.isfinite(along) & (along > 0)
    return np.asarray(camera + along[sound, None] * rays[sound], dtype=np.float64)
