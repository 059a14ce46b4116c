"""Plans the fingertip's path over the object: along a rectangle's perimeter in the depth image, or along a line."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pretouch.estimate import Estimate
from pretouch.geometry import Array, Pose
from pretouch.rectangle import RotatedRectangle
from pretouch.scene import SCAN_MARGIN, TABLE_BAND, Scene
from pretouch.session import ScanSettings
from pretouch.trajectory import Trajectory
from pretouch_orchestrator.perception.heightmap import HeightMap, build_height_map
from pretouch_orchestrator.perception.table import table_covariance
from pretouch_orchestrator.planning.tip_floor import GUARDED, SAFE, compute_reach, compute_tip_floor, lateral_std

_OCCLUDER_MARGIN = 0.06
"""m beyond the path's reach within which things may occlude the surface below the path."""
_SMOOTHING_WINDOW = 5
"""Number of perimeter pixels that are averaged, so that depth noise does not make the path zigzag."""
_MAX_STEPS = 4000
"""Upper limit of the pixels, and then of the points, along one perimeter."""
_WAYPOINT_SPACING = 0.006
_MAX_WAYPOINTS = 180
_HEIGHT_STEP = 0.001
"""m: heights are rounded up to multiples of it, so that the path over a flat top is level."""
_SPEED_MARGIN = 0.999
"""Share of the speed limit that is used, so that rounding does not exceed it."""


class PathPlanner:
    """Plans paths of the fingertip over one scene under one estimate.

    A path is given by its places on the ground, seen from above in the table's frame as the camera puts it. Its height
    clears everything that the camera saw or that may be hidden from it (`tip_floor`); its beam is opposite to the
    corrected table's normal.

    Args:
        beyond: m around the object over which paths may lead.

    Attributes:
        surface: the heights that the camera saw or that may be hidden from it.
        floor: (nx, ny), m, the lowest height of the tip over each cell of `surface`.
        reach: m around the beam within which heights count.
    """

    def __init__(self, scene: Scene, estimate: Estimate, settings: ScanSettings, beyond: float = SCAN_MARGIN) -> None:
        margins = GUARDED if settings.guarded else SAFE
        base_T_table = scene.table.frame()
        points = base_T_table.inverse().apply(scene.organised)
        lateral = _compute_lateral_std(points[scene.mask], base_T_table, estimate, beyond)
        self.reach = compute_reach(lateral, margins)
        self.surface = build_height_map(scene, beyond + self.reach + _OCCLUDER_MARGIN)
        self.floor = compute_tip_floor(self.surface, estimate, lateral, settings.standoff, margins)
        self._places = points[..., :2]
        self._shown = (scene.depth.metres > 0) & (scene.mask | (np.abs(points[..., 2]) < TABLE_BAND))
        self._base_T_map = estimate.base_T_correction @ base_T_table
        self._speed = settings.speed

    def follow_perimeter(self, rectangle: RotatedRectangle) -> Trajectory | None:
        """The path along a rectangle's perimeter, in the scene's pixels; None where it does not cross the object.

        It crosses depth jumps, and pixels that show neither object nor table, in straight lines; the parts far from
        the object are cut off.
        """
        ground = _trace_ground_path(rectangle, self._places, self._shown, self.surface)
        return None if ground is None else self._fly(ground)

    def follow_line(self, ends: Array) -> Trajectory:
        """The path along a straight line between `ends` (2, 2), m, in the table's frame."""
        return self._fly(_resample(ends, _WAYPOINT_SPACING, _MAX_WAYPOINTS))

    def _fly(self, ground: Array) -> Trajectory:
        """The tip's poses in base from t = 0 on over places (n, 2), m."""
        return _time_path(_raise_to_floor(ground, self.floor, self.surface), self._base_T_map, self._speed)


def plan_paths(
    scene: Scene,
    rectangles: Sequence[RotatedRectangle],
    estimate: Estimate,
    settings: ScanSettings,
) -> list[Trajectory | None]:
    """The whole path along each rectangle's perimeter: see `PathPlanner.follow_perimeter`."""
    planner = PathPlanner(scene, estimate, settings)
    return [planner.follow_perimeter(rectangle) for rectangle in rectangles]


def _compute_lateral_std(body: Array, base_T_table: Pose, estimate: Estimate, beyond: float) -> float:
    """m: the largest lateral standard deviation up to `beyond` m from the object.

    `body` (n, 3), m: the object's points in the table's frame.
    """
    low, high = body.min(axis=0) - beyond, body.max(axis=0) + beyond
    corners = np.stack(np.meshgrid(*np.stack([low, high], axis=1)), axis=-1).reshape(-1, 3)
    arms = corners - base_T_table.inverse().apply(estimate.centroid)
    return lateral_std(table_covariance(base_T_table, estimate), arms)


def _trace_ground_path(
    rectangle: RotatedRectangle, places: Array, shown: NDArray[np.bool_], surface: HeightMap
) -> Array | None:
    """The useful part of the perimeter seen from above: (n, 2), m, in the table's frame, evenly spaced.

    Args:
        places: (h, w, 2), m: each pixel's point, seen from above.
        shown: (h, w): pixels that show object or table.
    """
    spacing = max(1.0, 2 * (rectangle.w + rectangle.h) / _MAX_STEPS)
    pixels = np.round(rectangle.perimeter(spacing)[:-1]).astype(np.intp)
    h, w = shown.shape
    u, v = pixels.clip(0, (w - 1, h - 1)).T
    inside = (pixels == np.stack([u, v], axis=1)).all(axis=1)
    known = np.flatnonzero(inside & shown[v, u])
    if len(known) == 0:
        return None
    steps = np.arange(len(pixels))
    corners = places[v[known], u[known]]
    loop = np.stack([np.interp(steps, known, corners[:, k], period=len(steps)) for k in (0, 1)], axis=1)
    loop = ndimage.uniform_filter1d(loop, _SMOOTHING_WINDOW, axis=0, mode="wrap")
    loop = _resample(np.concatenate([loop, loop[:1]]), surface.cell, _MAX_STEPS)[:-1]
    away = surface.object_distance[surface.index(loop)]
    if away.min() > 2 * surface.cell:
        return None
    line = _cut_open(loop, away <= SCAN_MARGIN)
    path = _resample(line, _WAYPOINT_SPACING, _MAX_WAYPOINTS)
    return path if len(path) > 2 else None


def _resample(line: Array, spacing: float, most: int) -> Array:
    """At most `most` + 1 evenly spaced points (n, 2) along a polyline (m, 2), at most `spacing` m apart if possible."""
    travelled = np.insert(np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1)), 0, 0.0)
    count = int(np.clip(np.ceil(travelled[-1] / spacing), 1, most))
    at = np.linspace(0.0, travelled[-1], count + 1)
    return np.stack([np.interp(at, travelled, line[:, k]) for k in (0, 1)], axis=1)


def _cut_open(loop: Array, near: NDArray[np.bool_]) -> Array:
    """The `near` points of a loop (m, 2), starting after the widest gap; the closed loop if all points are near.

    The other gaps are crossed in straight lines.
    """
    starts = np.flatnonzero(near & ~np.roll(near, 1))
    if len(starts) == 0:
        return np.concatenate([loop, loop[:1]])
    ends = np.flatnonzero(near & ~np.roll(near, -1))
    last = ends[np.searchsorted(ends, starts) - 1]
    first = starts[np.argmax(np.linalg.norm(loop[starts] - loop[last], axis=1))]
    return np.roll(loop, -first, axis=0)[np.roll(near, -first)]


def _raise_to_floor(ground: Array, floor: Array, surface: HeightMap) -> Array:
    """The path (n, 3), m, in the table's frame: above `ground` (n, 2), and nowhere below `floor` between its points."""
    longest = float(np.linalg.norm(np.diff(ground, axis=0), axis=1).max())
    shares = np.linspace(0.0, 1.0, int(np.ceil(longest / surface.cell)) + 1)[:, None, None]
    lines = floor[surface.index((1 - shares) * ground[:-1] + shares * ground[1:])].max(axis=0)
    heights = np.maximum(np.append(lines, lines[-1]), np.insert(lines, 0, lines[0]))
    return np.column_stack([ground, np.ceil(heights / _HEIGHT_STEP) * _HEIGHT_STEP])


def _time_path(nodes: Array, base_T_map: Pose, speed: float) -> Trajectory:
    """The fastest allowed path through `nodes` (n, 3), m, in the map's frame, with the beam opposite to the map's z."""
    lengths = np.linalg.norm(np.diff(nodes, axis=0), axis=1)
    moved = np.insert(lengths > 1e-6, 0, True)
    poses = np.tile(np.eye(4), (int(moved.sum()), 1, 1))
    poses[:, :3, :3] = base_T_map.rotation @ np.diag([1.0, -1.0, -1.0])
    poses[:, :3, 3] = base_T_map.apply(nodes[moved])
    travelled = np.insert(np.cumsum(np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)), 0, 0.0)
    return Trajectory(travelled / (_SPEED_MARGIN * speed), poses)
