"""What a depth image shows above a table, cleaned of what depth cameras and masks add to an object."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError

from pretouch.geometry import Array, Plane, Pose
from pretouch.scene import MIN_OBJECT_PIXELS
from pretouch_orchestrator.perception.clusters import label_clusters, remove_flying_pixels
from pretouch_orchestrator.perception.table import height_std

Pixels = NDArray[np.bool_]

_MIN_PIXEL_HEIGHT = 0.004
"""m: least height, averaged over 3 x 3 pixels, of a pixel of an object; 2 sigma of one pixel where that is more."""
_OUTLINE_MARGIN = 0.01
"""m inside the outline of the visible table within which at least half of an object lies, unlike a wall behind it."""


@dataclass(frozen=True, eq=False)
class TableView:
    """A depth image and a table in it, in the camera frame.

    Attributes:
        depth: (h, w), m, 0 where there is no data.
        points: (h, w, 3), m.
        table: its normal towards the camera.
    """

    depth: NDArray[np.float32]
    points: Array
    table: Plane

    @cached_property
    def heights(self) -> Array:
        """(h, w), m above the table; meaningless where there is no depth."""
        return self.table.height(self.points)

    @cached_property
    def std(self) -> Array:
        """(h, w), m: standard deviation of `heights`."""
        return height_std(self.points, self.table.normal)

    @cached_property
    def level(self) -> Pixels:
        """(h, w): pixels at the table's height: the table, and stray ones where its plane cuts other things."""
        return np.asarray((self.depth > 0) & (np.abs(self.heights) < 3 * self.std + 0.002))

    @cached_property
    def raised(self) -> Pixels:
        """(h, w): pixels that rise above the table, by more than noise."""
        seen = self.depth > 0
        limit = np.maximum(0.02, 3 * self.std)
        flat = np.where(seen, np.clip(self.heights, -limit, limit), 0.0)
        mean = ndimage.uniform_filter(flat, 3) / np.maximum(ndimage.uniform_filter(seen.astype(np.float64), 3), 0.1)
        return np.asarray(seen & (mean > np.maximum(_MIN_PIXEL_HEIGHT, 2 * self.std)) & (self.heights > self.std))

    def label(self, pixels: Pixels) -> NDArray[np.intp]:
        """(h, w): the connected parts of `pixels` (h, w) without flying pixels: 1 the largest, 2 the next; 0 elsewhere.

        Pixels without depth do not separate where they are among `pixels` and next to ones with depth.
        """
        labels = np.zeros(pixels.shape, dtype=np.intp)
        if pixels.any():
            window = ndimage.find_objects(pixels.astype(np.int8))[0]
            depth = self.depth[window]
            bridged = np.where(depth > 0, depth, ndimage.maximum_filter(depth, 3))
            connected = label_clusters(bridged, remove_flying_pixels(bridged, pixels[window] & (bridged > 0)))
            labels[window] = np.where(depth > 0, connected, 0)
        return labels

    def cropped(self, window: tuple[slice, slice]) -> TableView:
        """The view within a window of its rows and columns."""
        return TableView(self.depth[window], self.points[window], self.table)

    def is_over_table(self, points: Array) -> bool:
        """Whether at least half of points (n, 3), m, lie over the table that is seen, not behind or beside it."""
        places = self._table_T_camera.apply(points)[:, :2]
        over = places @ self._outline[:, :2].T + self._outline[:, 2] <= -_OUTLINE_MARGIN
        return bool(over.all(axis=1).mean() >= 0.5)

    @cached_property
    def _table_T_camera(self) -> Pose:
        return self.table.frame().inverse()

    @cached_property
    def _outline(self) -> Array:
        """The convex hull of the table's large components: half planes (m, 3) with a x + b y + c <= 0 inside."""
        pieces, _ = ndimage.label(self.level, structure=np.ones((3, 3)))
        sizes = np.bincount(pieces.ravel())
        sizes[0] = 0
        large = (sizes >= max(MIN_OBJECT_PIXELS, 0.1 * sizes.max()))[pieces]
        edge = large & ~ndimage.binary_erosion(large)
        try:
            hull = ConvexHull(self._table_T_camera.apply(self.points[edge])[:, :2])
        except (QhullError, ValueError):
            return np.zeros((0, 3))
        return np.asarray(hull.equations, dtype=np.float64)
