"""The ranges that a fingertip should read along a scan, predicted from the depth image and the pose uncertainty."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pretouch.estimate import Estimate
from pretouch.geometry import Array, Pose, rotation_from_vector
from pretouch.scene import Scene
from pretouch_orchestrator.perception.heightmap import build_height_map
from pretouch_orchestrator.perception.table import table_covariance

_REACH = 0.05
"""m around the object that the surface covers: the reach of paths plus the error of the pose."""
_LATERAL_STD = 0.01
"""m, per lateral axis of the table: least standard deviation of the surface's position. The estimate may be
overconfident, and lateral errors of 2 cm must remain possible explanations."""
_DRAWS = np.random.default_rng(0).standard_normal((50, 6))
_NORMAL_SAMPLES = np.concatenate([_DRAWS, -_DRAWS])
"""Fixed standard normal samples, each together with its opposite."""
_MAX_GAP = 0.004
"""m: a cell this near to a seen one gets its height; pixels are that far apart on a slanted surface."""
_MAX_TABLE_HEIGHT = 0.003
"""m above the table up to which hidden cells are taken to be the table."""
_MIN_DOWNWARD = 0.1
"""Downward component of a beam's direction below which it is followed no farther than _LEVEL_REACH."""
_LEVEL_REACH = 0.15
"""m: that a level beam is followed, which may hit a wall."""
_NO_HIT_RANGE = 1.0
"""m: the range of a beam that hits nothing."""
_MAX_STEPS = 256
_BEAMS_AT_ONCE = 1024
"""Beams that are followed together, which takes memory for all of their steps."""


@dataclass(frozen=True, eq=False)
class Surface:
    """The believed surface as presently corrected: heights over the table's plane.

    Attributes:
        table_T_base: to the frame of the table.
        origin, cell: (2,), m, and m: the position of cell (0, 0) and the size of a cell.
        heights: (nx, ny), m above the table.
        known: (nx, ny): cells that were seen, or can only be the table.
        centroid: (3,), m, in the table's frame.
        displacements: (k, 6): samples of the surface's pose error: a rotation vector about the centroid, rad, and a
            translation, m, in the table's axes.
    """

    table_T_base: Pose
    origin: Array
    cell: float
    heights: Array
    known: NDArray[np.bool_]
    centroid: Array
    displacements: Array

    @staticmethod
    def from_estimate(scene: Scene, estimate: Estimate) -> Surface:
        """The surface that the camera saw, corrected by the estimate."""
        seen = build_height_map(scene, _REACH)
        unseen = np.isnan(seen.seen)
        distance, nearest = ndimage.distance_transform_edt(unseen, sampling=seen.cell, return_indices=True)
        shown = distance <= _MAX_GAP
        table_T_base = seen.base_T_table.inverse()
        return Surface(
            table_T_base @ estimate.base_T_correction.inverse(),
            seen.origin,
            seen.cell,
            heights=np.where(shown, seen.seen[tuple(nearest)], 0.0),
            known=shown | (seen.believed <= _MAX_TABLE_HEIGHT),
            centroid=table_T_base.apply(estimate.centroid),
            displacements=_sample_displacements(table_covariance(seen.base_T_table, estimate)),
        )

    def dilate(self, radius: float) -> Surface:
        """The surface as a cone sees it that reads the nearest point within `radius`, m, of its axis."""
        size = 2 * int(np.ceil(radius / self.cell)) + 1
        return replace(self, heights=ndimage.maximum_filter(self.heights, size=size, mode="nearest"))

    def predict_ranges(self, origins: Array, directions: Array) -> Array:
        """(n,), m: the range at which beams, in base, first hit the surface; 1 m where they do not."""
        return self._intersect(self.table_T_base.apply(origins), directions @ self.table_T_base.rotation.T)

    def sample_ranges(self, origins: Array, directions: Array) -> Array:
        """(k, n), m: `predict_ranges` for each sample of the surface's pose error."""
        starts, ways = self.table_T_base.apply(origins), directions @ self.table_T_base.rotation.T
        sampled = []
        for displacement in self.displacements:
            turn = rotation_from_vector(displacement[:3])
            moved = (starts - self.centroid - displacement[3:]) @ turn + self.centroid
            sampled.append(self._intersect(moved, ways @ turn))
        return np.stack(sampled)

    def is_known_at(self, origins: Array, directions: Array) -> NDArray[np.bool_]:
        """(n,): whether each beam hits a cell that is known, or nothing."""
        ranges = self.predict_ranges(origins, directions)
        ends = self.table_T_base.apply(origins + ranges[:, None] * directions)
        return np.asarray(self.known[self._index(ends[:, :2])] | (ranges >= _NO_HIT_RANGE), dtype=bool)

    def _index(self, places: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        cells = np.round((places - self.origin) / self.cell).astype(np.intp)
        nx, ny = self.heights.shape
        return cells[..., 0].clip(0, nx - 1), cells[..., 1].clip(0, ny - 1)

    def _intersect(self, starts: Array, ways: Array) -> Array:
        """`predict_ranges` in the table's frame."""
        parts = range(0, len(starts), _BEAMS_AT_ONCE)
        met = [self._follow(starts[k : k + _BEAMS_AT_ONCE], ways[k : k + _BEAMS_AT_ONCE]) for k in parts]
        return np.concatenate([np.zeros(0), *met])

    def _follow(self, starts: Array, ways: Array) -> Array:
        """`_intersect` for a few beams, in steps of one cell; vertical beams take a single step."""
        falling, down = -ways[:, 2] >= _MIN_DOWNWARD, -ways[:, 2:]
        fall = np.where(falling, down[:, 0], 1.0)
        longest = np.where(falling, (starts[:, 2] - min(float(self.heights.min()), 0.0)) / fall, _LEVEL_REACH)
        travelled = float((longest * np.linalg.norm(ways[:, :2], axis=1)).max(initial=0.0))
        steps = int(np.clip(np.ceil(travelled / self.cell), 1, _MAX_STEPS))
        ends = longest[:, None] * np.arange(1, steps + 1) / steps
        begins = ends - longest[:, None] / steps
        places = starts[:, None, :2] + ends[..., None] * ways[:, None, :2]
        above = starts[:, 2:] - self.heights[self._index(places)]
        at = np.where(falling[:, None], above / fall[:, None], ends)
        met = np.where(above <= ends * down + 1e-9, np.maximum(at, begins), np.inf).min(axis=1)
        return np.where(np.isfinite(met), np.maximum(met, 0.0), _NO_HIT_RANGE)


def _sample_displacements(covariance: Array) -> Array:
    """(k, 6): deterministic samples of a covariance (6, 6) in the table's axes, laterally at least `_LATERAL_STD`."""
    widened = covariance.copy()
    for axis in (3, 4):
        widened[axis, axis] = max(widened[axis, axis], _LATERAL_STD**2)
    values, vectors = np.linalg.eigh(widened)
    return np.asarray(_NORMAL_SAMPLES @ (vectors * np.sqrt(np.maximum(values, 0.0))).T, dtype=np.float64)
