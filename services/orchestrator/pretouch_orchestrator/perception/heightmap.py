"""A height map of the surface that the finger must not touch, as believed from the depth image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pretouch.geometry import Array, Pose
from pretouch.scene import Scene
from pretouch_orchestrator.perception.clusters import remove_flying_pixels
from pretouch_orchestrator.perception.shadow import compute_shadow_ceiling, fill_holes

_CELL = 0.002
_MAX_CELLS = 256
"""Upper limit of the cells along one side: a larger area gets larger cells."""


@dataclass(frozen=True, eq=False)
class HeightMap:
    """Heights above the table over a grid of its plane.

    The correction moves everything that the camera saw as one rigid body, the table included, so the map does not
    depend on it: `base_T_correction * base_T_table` maps it to base as presently corrected.

    Attributes:
        base_T_table: the table's frame as the camera puts it; z along its normal.
        origin: (2,), m, the position of cell (0, 0) in the table's frame.
        cell: m, the size of a cell.
        believed: (nx, ny), m, at least 0: the highest point that is or may be there, hidden points included.
        seen: (nx, ny), m: the highest point seen there; NaN where there is none.
        object_distance: (nx, ny), m, in the table's plane, to the nearest cell where the object was seen.
    """

    base_T_table: Pose
    origin: Array
    cell: float
    believed: Array
    seen: Array
    object_distance: Array

    def index(self, places: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """The cells of `places` (..., 2), m, in the table's frame; the nearest cell for a place outside the map."""
        cells = np.round((places - self.origin) / self.cell).astype(np.intp)
        nx, ny = self.believed.shape
        return cells[..., 0].clip(0, nx - 1), cells[..., 1].clip(0, ny - 1)

    def places(self) -> tuple[Array, Array]:
        """x (nx, 1) and y (1, ny), m, of the cells in the table's frame."""
        nx, ny = self.believed.shape
        x, y = (origin + self.cell * np.arange(n) for origin, n in zip(self.origin, (nx, ny), strict=True))
        return x[:, None], y[None, :]


def build_height_map(scene: Scene, reach: float) -> HeightMap:
    """The height map of the area within `reach`, m, of the object.

    It assumes that nothing in a hole of the depth image is higher than its surroundings, that nothing hidden rises
    above the line of sight over what hides it, and that beyond the view there is only the table.
    """
    base_T_table = scene.table.frame()
    table_T_camera = base_T_table.inverse() @ scene.base_T_camera
    depth = scene.depth.metres
    seen = (depth > 0) & (scene.mask | remove_flying_pixels(depth, depth > 0))
    points = table_T_camera.apply(scene.camera.back_project_image(np.where(seen, depth, 1.0)))
    body = points[scene.mask]
    low, high = body[:, :2].min(axis=0) - reach, body[:, :2].max(axis=0) + reach
    cell = max(_CELL, float((high - low).max()) / (_MAX_CELLS - 1))
    shape = tuple(np.ceil((high - low) / cell).astype(int) + 1)

    def project_to_top_view(cloud: Array) -> Array:
        cells = np.round((cloud[:, :2] - low) / cell).astype(np.intp)
        inside = ((cells >= 0) & (cells < shape)).all(axis=1)
        heights = np.full(shape, -np.inf)
        np.maximum.at(heights, (cells[inside, 0], cells[inside, 1]), cloud[inside, 2])
        return heights

    tops = project_to_top_view(points[seen])
    holes = project_to_top_view(fill_holes(points, seen, table_T_camera.translation))
    solid = np.maximum(np.maximum(tops, holes), 0.0)
    ceiling = compute_shadow_ceiling(solid, cell, table_T_camera.translation - (*low, 0.0))
    beyond_object = np.isneginf(project_to_top_view(body))
    return HeightMap(
        base_T_table,
        low,
        cell,
        believed=np.maximum(solid, ceiling),
        seen=np.where(np.isfinite(tops), tops, np.nan),
        object_distance=np.asarray(ndimage.distance_transform_edt(beyond_object) * cell, dtype=np.float64),
    )
