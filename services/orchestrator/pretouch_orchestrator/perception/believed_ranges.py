"""What a fingertip should read along a scan, by what the camera saw and wherever its error may have put that."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pretouch.estimate import Estimate
from pretouch.geometry import Array, Pose, rotation_from_vector
from pretouch.scene import Scene
from pretouch_orchestrator.perception.heightmap import height_map
from pretouch_orchestrator.perception.table import table_covariance

_REACH = 0.05
"""m around the object that is looked at: where paths go, and how far off what is there may be."""
_LATERAL_STD = 0.01
"""m, per axis of the table, that the surface may be off to a side at least: an estimate may be surer than it is
right, and 2 cm must explain what they can."""
_DRAWS = np.random.default_rng(0).standard_normal((50, 6))
_NORMAL = np.concatenate([_DRAWS, -_DRAWS])
_GAP = 0.004
"""m: a place this near to one that was seen is as high; the pixels are that far apart on a slanted surface."""
_LEVEL = 0.003
"""m above the table that nothing hidden rises above where the table is taken for granted."""
_STEEPEST = 0.1
"""Share of a beam's direction that points down at least: others meet the table far away or nowhere."""
_FAR = 1.0
"""m: what a beam that meets nothing is said to read."""
_MAX_STEPS = 256


@dataclass(frozen=True, eq=False)
class Surface:
    """The believed surface as presently corrected, z along the table's normal.

    Attributes:
        table_T_base: to the frame of the table.
        origin, cell: (2,), m, and m: the place of cell (0, 0) and the cells' size.
        heights: (nx, ny), m above the table.
        known: (nx, ny): the heights that were seen, not hidden.
        centroid: (3,), m, in the table's frame.
        displacements: (k, 6): draws of where the surface may be instead, a rotation vector about the centroid and a
            shift, rad and m, in the table's axes.
    """

    table_T_base: Pose
    origin: Array
    cell: float
    heights: Array
    known: NDArray[np.bool_]
    centroid: Array
    displacements: Array

    @staticmethod
    def of(scene: Scene, estimate: Estimate) -> Surface:
        """What the view shows, moved as the estimate says."""
        seen = height_map(scene, _REACH)
        unseen = np.isnan(seen.seen)
        distance, nearest = ndimage.distance_transform_edt(unseen, sampling=seen.cell, return_indices=True)
        shown = distance <= _GAP
        table_T_base = seen.base_T_table.inverse()
        return Surface(
            table_T_base @ estimate.base_T_correction.inverse(),
            seen.origin,
            seen.cell,
            heights=np.where(shown, seen.seen[tuple(nearest)], 0.0),
            known=shown | (seen.believed <= _LEVEL),
            centroid=table_T_base.apply(estimate.centroid),
            displacements=_drawn(table_covariance(seen.base_T_table, estimate)),
        )

    def widened(self, radius: float) -> Surface:
        """As whoever reads the nearest part within `radius`, m, of the beam sees it."""
        size = 2 * int(np.ceil(radius / self.cell)) + 1
        return replace(self, heights=ndimage.maximum_filter(self.heights, size=size, mode="nearest"))

    def ranges(self, origins: Array, directions: Array) -> Array:
        """(n,), m: where beams, in base, first meet the surface; 1 m where they do not."""
        return self._met(self.table_T_base.apply(origins), directions @ self.table_T_base.rotation.T)

    def drawn_ranges(self, origins: Array, directions: Array) -> Array:
        """(k, n), m: `ranges` with the surface at each of the places where it may be."""
        starts, ways = self.table_T_base.apply(origins), directions @ self.table_T_base.rotation.T
        drawn = []
        for displacement in self.displacements:
            turn = rotation_from_vector(displacement[:3])
            moved = (starts - self.centroid - displacement[3:]) @ turn + self.centroid
            drawn.append(self._met(moved, ways @ turn))
        return np.stack(drawn)

    def known_at(self, origins: Array, directions: Array) -> NDArray[np.bool_]:
        """(n,): whether the place that each beam meets was seen."""
        ends = origins + self.ranges(origins, directions)[:, None] * directions
        return np.asarray(self.known[self._index(self.table_T_base.apply(ends)[:, :2])], dtype=bool)

    def _index(self, places: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        cells = np.round((places - self.origin) / self.cell).astype(np.intp)
        nx, ny = self.heights.shape
        return cells[..., 0].clip(0, nx - 1), cells[..., 1].clip(0, ny - 1)

    def _met(self, starts: Array, ways: Array) -> Array:
        """`ranges` in the table's frame: steps of one cell over the ground, one alone for beams straight down."""
        down = np.maximum(-ways[:, 2], _STEEPEST)
        longest = (starts[:, 2] - min(float(self.heights.min()), 0.0)) / down
        travelled = float((longest * np.linalg.norm(ways[:, :2], axis=1)).max(initial=0.0))
        steps = int(np.clip(np.ceil(travelled / self.cell), 1, _MAX_STEPS))
        ends = longest[:, None] * np.arange(1, steps + 1) / steps
        begins = ends - longest[:, None] / steps
        places = starts[:, None, :2] + ends[..., None] * ways[:, None, :2]
        at = (starts[:, 2:] - self.heights[self._index(places)]) / down[:, None]
        met = np.where(at <= ends + 1e-9, np.maximum(at, begins), np.inf).min(axis=1)
        return np.where((-ways[:, 2] >= _STEEPEST) & np.isfinite(met), np.maximum(met, 0.0), _FAR)


def _drawn(covariance: Array) -> Array:
    """(k, 6): fixed draws of covariance (6, 6), in the table's axes, to a side no surer than `_LATERAL_STD`."""
    widened = covariance.copy()
    for axis in (3, 4):
        widened[axis, axis] = max(widened[axis, axis], _LATERAL_STD**2)
    values, vectors = np.linalg.eigh(widened)
    return np.asarray(_NORMAL @ (vectors * np.sqrt(np.maximum(values, 0.0))).T, dtype=np.float64)
