"""Short lines over what the camera saw beside the object, for when the object itself is out of the finger's reach.

Table and neighbouring things share the camera's calibration error: their heights and edges correct the object's pose
too, and then the finger may go lower over the object.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pretouch.geometry import Array
from pretouch.scene import Scene
from pretouch_orchestrator.perception.heightmap import HeightMap
from pretouch_orchestrator.planning.path import PathPlanner

BEYOND = 0.12
"""m around the object within which such lines lie."""
_LENGTH = 0.05
_SPACING = 0.015
"""m between the middles of the lines that are considered."""
_HEADINGS = 4
_MIN_VISIBLE = 0.9
"""Share of a line that must be within the sensor's range."""
_RANGE_MARGIN = 0.01
"""m that the expected range is less than the sensor's longest one."""
_MOST = 16


def trace_surroundings(scene: Scene, planner: PathPlanner, range_max: float) -> list[Array]:
    """At most 16 lines as their ends (2, 2), m, in the table's frame, spread over what can be seen.

    Whatever lies within the planner's reach of them is in the camera's view: beyond it nothing is known.

    Args:
        planner: for paths up to BEYOND m around the object.
        range_max: m, the sensor's longest range.
    """
    surface = planner.surface
    visible = planner.floor - surface.seen <= range_max - _RANGE_MARGIN  # False where nothing was seen
    visible &= (surface.object_distance > 0) & (surface.object_distance <= BEYOND)
    visible &= _find_surveyed(scene, surface, planner.reach)
    step = max(1, round(_SPACING / surface.cell))
    middles = np.argwhere(visible[::step, ::step]) * step * surface.cell + surface.origin
    offsets = np.linspace(-0.5, 0.5, 2 * int(_LENGTH / surface.cell) + 1) * _LENGTH
    lines = []
    for heading in np.pi * np.arange(_HEADINGS) / _HEADINGS:
        way = np.array([np.cos(heading), np.sin(heading)])
        over = visible[surface.index(middles[:, None] + offsets[:, None] * way)].mean(axis=1)
        lines += [middle + offsets[[0, -1], None] * way for middle in middles[over >= _MIN_VISIBLE]]
    return _spread_out(lines)


def _find_surveyed(scene: Scene, surface: HeightMap, reach: float) -> NDArray[np.bool_]:
    """(nx, ny): cells around which everything within `reach`, m, is in the camera's view."""
    x, y = surface.places()
    ground = np.stack([*np.broadcast_arrays(x, y), np.zeros(surface.believed.shape)], axis=-1)
    seen = scene.base_T_camera.inverse().apply(surface.base_T_table.apply(ground))
    u, v = np.moveaxis(scene.camera.project(seen), -1, 0)
    h, w = scene.depth.metres.shape
    in_view = (seen[..., 2] > 0) & (u >= 0) & (v >= 0) & (u <= w - 1) & (v <= h - 1)
    padded = np.pad(in_view, 1)
    return np.asarray(ndimage.distance_transform_edt(padded)[1:-1, 1:-1] * surface.cell > reach, dtype=bool)


def _spread_out(lines: list[Array]) -> list[Array]:
    """The first line, then always the one whose middle is farthest from all before."""
    if not lines:
        return []
    middles = np.array([line.mean(axis=0) for line in lines])
    chosen = [0]
    distance = np.linalg.norm(middles - middles[0], axis=1)
    while len(chosen) < min(_MOST, len(lines)) and distance.max() > 0:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(middles - middles[chosen[-1]], axis=1))
    return [lines[k] for k in chosen]
