"""The model of what the camera saw: the smoothed surface, the kind of each pixel, distances to the nearest edge."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError

from pretouch.cancellation import check_cancelled
from pretouch.geometry import Array
from pretouch.rotational_symmetry import find_symmetry_axis
from pretouch.scene import Scene
from pretouch_registrar.engines.camera_noise import CameraNoise, measure_camera_noise
from pretouch_registrar.engines.plane_fits import Window, fit_planes

UNSEEN, OBJECT, TABLE, OTHER = 0, 1, 2, 3
"""Kinds of a pixel: no depth, the object, the table, or another object."""

_TABLE_BAND = 0.003
"""m from the table's plane within which a pixel shows the table, plus three standard deviations of its noise."""
_FIT_RADIUS = 0.005
"""m on the surface: half width of a plane fit; about three pixels of a Kinect at 0.9 m."""
_FIT_BAND = 0.0035
"""m: residual beyond which a neighbour gets little weight in a plane fit."""
_MAX_STEPS = 4
"""Neighbours on each side of a plane fit; wider windows are subsampled to this many."""
NOWHERE = 1e6
"""m: plane and point of a front layer where there is none; finite, so that differences of it stay finite."""
_LAYER_GAP = 0.015
"""m: a surface this far in front of another one beside it in the image is a front layer, such as a cup's near rim."""
_LAYER_REACH = 0.008
"""m across the view within which two layers are beside each other: between them some pixels have no depth."""
RIM = 0.006
"""m inside a silhouette over which window-matching cameras blend the object with its background."""
CELL = 0.003
"""m: side of a cell of the footprint."""
_FOOTPRINT_MARGIN = 14
"""Cells around the object that the footprint includes."""
_LAYER = 0.004
"""m: points of a cell this far below its highest one belong to the same surface."""
_MAX_POINTS = 5000
"""Points of the cloud that are tested for rotational symmetry."""
_MAX_LEVELS = 128
"""Heights at which the line of sight over the object is looked for: those of objects above 38 cm are farther apart than
a cell."""
_CONE_REACH = 11
"""Cells around a cell that a ray may cross before it hits the surface."""


class Surface(NamedTuple):
    """The plane n . p = d of each pixel of an image (h, w), and its point; base frame, float32.

    Attributes:
        normals: (h, w, 3), unit, towards the camera.
        offsets: (h, w), m.
        points: (h, w, 3), m.
    """

    normals: NDArray[np.float32]
    offsets: NDArray[np.float32]
    points: NDArray[np.float32]


class Pixels(NamedTuple):
    """What the camera saw, pixel by pixel.

    Attributes:
        surface: the smoothed surface; where neither the object nor another one is seen, that of the nearest object
            pixel.
        front: that of the nearest pixel of the object's front layers; NOWHERE without any.
        distances: (h, w) float32, px, to the pixel that `surface` was taken from.
        rims: (h, w) float32, how near the silhouette that pixel is: 1 on it, decaying over RIM.
        kinds: (h, w) int8, UNSEEN, OBJECT, TABLE or OTHER.
    """

    surface: Surface
    front: Surface
    distances: NDArray[np.float32]
    rims: NDArray[np.float32]
    kinds: NDArray[np.int8]


class Footprint(NamedTuple):
    """The object seen from above, in float32 cells (nx, ny) of side CELL in the table's plane.

    Attributes:
        top: m above the table, of the highest point seen; below 0 where there is none.
        inside: m to the nearest cell outside the object.
        outward_x, outward_y: unit vector towards that cell.
        low, high: m above the table, bounds of the surface's height here, equal where it was seen.
        facing: cosine of its slope.
        nearby: m above the table, the largest `high` within the reach of a cone.
        hidden: bool, whether `low` and `high` differ anywhere within it.
        beyond: m from the nearest cell where the object was seen.
        hull: 1 within the convex hull of what was seen, else 0.
        x_axis, y_axis: (3,) float64, unit, the table's axes in base.
        corner: (2,) float64, m along them, where the first cell begins.
    """

    top: NDArray[np.float32]
    inside: NDArray[np.float32]
    outward_x: NDArray[np.float32]
    outward_y: NDArray[np.float32]
    low: NDArray[np.float32]
    high: NDArray[np.float32]
    facing: NDArray[np.float32]
    nearby: NDArray[np.float32]
    hidden: NDArray[np.bool_]
    beyond: NDArray[np.float32]
    hull: NDArray[np.float32]
    x_axis: Array
    y_axis: Array
    corner: Array


@dataclass(frozen=True, eq=False)
class CameraModel:
    """The model of one scene, in base as the camera puts it.

    Attributes:
        free_turn: (6,), the correction that turns the object about the vertical by 1 rad, if it is so exactly
            symmetric about it that this turn cannot be observed.
    """

    scene: Scene
    pixels: Pixels
    footprint: Footprint
    noise: CameraNoise
    free_turn: Array | None


def build(scene: Scene) -> CameraModel:
    """The model of one scene; about 60 ms for a scene cropped around its object."""
    metres = np.ascontiguousarray(scene.depth.metres, dtype=np.float64)
    noise = measure_camera_noise(scene)
    camera, mask = scene.camera, scene.mask
    near_table = np.abs(scene.table.height(scene.organised)) < _TABLE_BAND + 3 * noise.pixel
    kind = np.select([mask, metres <= 0, near_table], [OBJECT, UNSEEN, TABLE], OTHER)
    px_per_m = camera.fx / float(np.median(metres[mask]))
    stride = max(1, round(_FIT_RADIUS * px_per_m / _MAX_STEPS))
    steps = max(2, round(_FIT_RADIUS * px_per_m / stride))
    solid = (kind == OBJECT) | (kind == OTHER)
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    depth, normals = fit_planes(metres, solid, intrinsics, Window(steps, stride, _FIT_BAND))
    points = scene.base_T_camera.apply(camera.back_project_image(depth))
    normals = scene.base_T_camera.rotate(normals)
    offsets = np.einsum("ijk,ijk->ij", normals, points)
    distance, nearest = _find_nearest(mask)
    inside = ndimage.distance_transform_edt(mask) / px_per_m
    rims = np.where(mask, np.exp(-inside / RIM), 0.0)[tuple(nearest)]
    own = kind == OTHER
    rims[own] = 0.0
    nearest[:, own], distance[own] = np.indices(mask.shape)[:, own], 0.0
    check_cancelled()
    layers = _find_front_layers(metres, mask, round(_LAYER_REACH * px_per_m))
    pixels = Pixels(
        _gather(normals, offsets, points, nearest),
        _gather(normals, offsets, points, _find_nearest(layers)[1])
        if layers.any()
        else _make_empty_surface(mask.shape),
        _to_single(distance),
        _to_single(rims),
        np.ascontiguousarray(kind, dtype=np.int8),
    )
    check_cancelled()
    footprint = _build_footprint(scene, points[mask], metres, kind)
    check_cancelled()
    return CameraModel(scene, pixels, footprint, noise, _find_free_turn(scene))


def _find_free_turn(scene: Scene) -> Array | None:
    """`CameraModel.free_turn`."""
    cloud, up = scene.cloud, scene.table.normal
    found = find_symmetry_axis(cloud[:: -(-len(cloud) // _MAX_POINTS)], up)
    if found is None or not found.certain:
        return None
    return np.concatenate([up, np.cross(up, scene.centroid - found.point)])


def _gather(normals: Array, offsets: Array, points: Array, nearest: NDArray[np.int32]) -> Surface:
    """The surface whose pixels are those at (v, u) (2, h, w) of the arrays given."""
    v, u = nearest
    return Surface(_to_single(normals[v, u]), _to_single(offsets[v, u]), _to_single(points[v, u]))


def _make_empty_surface(shape: tuple[int, ...]) -> Surface:
    """A surface far from everything, in each pixel of an image (h, w)."""
    vectors = np.full((*shape, 3), NOWHERE, dtype=np.float32)
    return Surface(vectors, np.full(shape, NOWHERE, dtype=np.float32), vectors)


def _to_single(values: Array) -> NDArray[np.float32]:
    return np.ascontiguousarray(values, dtype=np.float32)


def _find_nearest(mask: NDArray[np.bool_]) -> tuple[Array, NDArray[np.int32]]:
    """Distance (h, w), px, to the mask's nearest pixel, and that pixel's (v, u) (2, h, w)."""
    distance, nearest = ndimage.distance_transform_edt(~mask, return_indices=True)
    return distance, nearest


def _find_front_layers(metres: Array, mask: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """(h, w) True on object pixels within `reach` pixels of others that lie behind them by more than _LAYER_GAP."""
    size = [2 * min(reach, n) + 1 for n in mask.shape]
    farthest = ndimage.maximum_filter(np.where(mask, metres, 0.0), size=size)
    return np.asarray(mask & (farthest - metres > _LAYER_GAP))


def _build_footprint(scene: Scene, points: Array, metres: Array, kind: NDArray[np.int64]) -> Footprint:
    """The object's surface points (n, 3) from above."""
    axes = scene.table.frame().rotation
    xy = points @ axes[:, :2]
    corner = xy.min(axis=0) - _FOOTPRINT_MARGIN * CELL
    cells = np.floor((xy - corner) / CELL).astype(np.int64)
    top = np.full(tuple(cells.max(axis=0) + _FOOTPRINT_MARGIN + 1), -1.0)
    np.maximum.at(top, tuple(cells.T), scene.table.height(points))
    seen = top >= 0
    closed = ndimage.binary_closing(seen, iterations=1)
    beyond, nearest = ndimage.distance_transform_edt(~seen, return_indices=True)
    top = np.where(closed, top[nearest[0], nearest[1]], -1.0)
    inside, edge = ndimage.distance_transform_edt(closed, return_indices=True)
    outward = (edge - np.indices(closed.shape)) / np.maximum(inside, 1e-9)
    upper = _average_top(top, cells, scene.table.height(points))
    upper = np.where(top >= 0, upper, _map_other_objects(scene, axes, corner, top.shape, kind))
    low, high = _bound_heights(scene, upper, axes, corner, metres, kind)
    smooth = ndimage.gaussian_filter(low, 1.0)
    slope = np.hypot(*np.gradient(smooth, CELL))
    facing = 1.0 / np.sqrt(1.0 + slope**2)
    nearby = ndimage.maximum_filter(high, size=2 * _CONE_REACH + 1)
    hidden = ndimage.maximum_filter(high - low, size=2 * _CONE_REACH + 1) > 0.0
    return Footprint(
        _to_single(top),
        _to_single(inside * CELL),
        _to_single(outward[0]),
        _to_single(outward[1]),
        _to_single(low),
        _to_single(high),
        _to_single(facing),
        _to_single(nearby),
        hidden,
        _to_single(beyond * CELL),
        _to_single(_fill_hull(seen)),
        axes[:, 0].copy(),
        axes[:, 1].copy(),
        corner,
    )


def _map_other_objects(
    scene: Scene, axes: Array, corner: Array, shape: tuple[int, ...], kind: NDArray[np.int64]
) -> Array:
    """(nx, ny), m above the table: the heights of other objects; below 0 where there are none.

    Strips of fewer than three pixels are left out: they are mixed pixels at silhouettes.
    """
    heights = np.full(shape, -1.0)
    points = scene.organised[ndimage.binary_opening(kind == OTHER, np.ones((3, 3)))]
    cells = np.floor((points @ axes[:, :2] - corner) / CELL).astype(np.int64)
    within = ((cells >= 0) & (cells < shape)).all(axis=1)
    np.maximum.at(heights, tuple(cells[within].T), scene.table.height(points[within]))
    seen = heights >= 0
    if not seen.any():
        return heights
    closed = ndimage.binary_closing(seen, iterations=1)
    _, nearest = ndimage.distance_transform_edt(~seen, return_indices=True)
    return np.where(closed, heights[nearest[0], nearest[1]], -1.0)


def _fill_hull(seen: NDArray[np.bool_]) -> Array:
    """(nx, ny): 1 within the convex hull of the cells `seen`; if it has no area, on those cells alone."""
    cells = np.argwhere(seen)
    if len(cells) == 0:  # the table that the client gave is above the object
        return np.zeros(seen.shape)
    try:
        equations = ConvexHull(cells).equations
    except QhullError:
        return seen.astype(np.float64)
    x, y = np.arange(seen.shape[0])[:, None], np.arange(seen.shape[1])
    within = np.ones(seen.shape)
    for a, b, c in equations:  # one after the other: all at once would take cells times edges of memory
        within[a * x + b * y + c > 1e-9] = 0.0
    return within


def _average_top(top: Array, cells: NDArray[np.int64], heights: Array) -> Array:
    """Mean height of the points near each cell's highest one, which alone would be too high by noise; else `top`."""
    near = heights > top[tuple(cells.T)] - _LAYER
    total, count = np.zeros(top.shape), np.zeros(top.shape)
    np.add.at(total, tuple(cells[near].T), heights[near])
    np.add.at(count, tuple(cells[near].T), 1.0)
    return np.where(count > 0, total / np.maximum(count, 1.0), top)


def _bound_heights(
    scene: Scene, top: Array, axes: Array, corner: Array, metres: Array, kind: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Bounds, m above the table, of the surface's height over each cell of `top` (nx, ny).

    Where the camera saw the object, both are its height; where it saw the table, 0; in the object's shadow, 0 and the
    height of the line of sight that passes over the object.
    """
    low = np.maximum(top, 0.0)
    high = low.copy()
    i, j = np.nonzero(top < 0)
    across = corner + (np.stack([i, j], axis=1) + 0.5) * CELL
    foot = axes[:, :2] @ across.T
    foot = foot.T + scene.table.normal * (scene.table.offset - foot.T @ scene.table.normal)[:, None]
    camera_T_base, c = scene.base_T_camera.inverse(), scene.camera
    highest = float(top.max())
    levels = np.arange(0.0, highest + CELL, max(CELL, highest / _MAX_LEVELS))
    up, intrinsics = camera_T_base.rotate(scene.table.normal), np.array([c.fx, c.fy, c.cx, c.cy])
    bound = _find_lines_of_sight(camera_T_base.apply(foot), up, levels, metres, kind, intrinsics)
    high[i, j] = np.maximum(high[i, j], bound)
    return low, high


@njit(cache=True, nogil=True, error_model="numpy")
def _find_lines_of_sight(
    feet: Array, up: Array, levels: Array, metres: Array, kind: NDArray[np.int64], intrinsics: Array
) -> Array:
    """(n,), m: the last of the increasing `levels` above each foot up to which all are hidden by things; 0 if none is.

    Args:
        feet: (n, 3), m, on the table, and `up` (3,), its normal, in the camera's frame.
        metres, kind: (h, w).
        intrinsics: (4,), fx, fy, cx, cy, px.
    """
    fx, fy, cx, cy = intrinsics
    bounds = np.zeros(len(feet))
    for n in range(len(feet)):
        for level in levels:
            z = feet[n, 2] + level * up[2]
            if z < 1e-3:
                break
            u = int(np.rint(fx * (feet[n, 0] + level * up[0]) / z + cx))
            v = int(np.rint(fy * (feet[n, 1] + level * up[1]) / z + cy))
            if u < 0 or v < 0 or u >= metres.shape[1] or v >= metres.shape[0]:
                break
            if (kind[v, u] != OBJECT and kind[v, u] != OTHER) or z <= metres[v, u] + 0.004:
                break
            bounds[n] = level
    return bounds
