"""What the camera saw, ready to be asked: smoothed surface, kind of each pixel, way to the nearest edge."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError

from pretouch.geometry import Array
from pretouch.scene import Scene
from pretouch_registrar.engines.camera_noise import CameraNoise, camera_noise
from pretouch_registrar.engines.plane_fits import fit_planes
from pretouch_registrar.revolution import revolution_about

UNSEEN, OBJECT, TABLE, OTHER = 0, 1, 2, 3
"""Kinds of a pixel: no depth, the object, the table, or something else that stands about."""

_TABLE_BAND = 0.003
"""m about the table's plane within which a pixel is the table's, besides three standard deviations of its noise."""
_FIT_RADIUS = 0.005
"""m on the surface: half width of a plane fit; about three pixels of a Kinect at 0.9 m."""
_FIT_BAND = 0.0035
"""m: residual at which a neighbour counts little in a plane fit."""
_MAX_STEPS = 4
"""Neighbours on each side of a plane fit; wider windows are thinned out to this many."""
NOWHERE = 1e6
"""m: plane and point of a front layer where there is none; finite, since the kernels know no infinity."""
_LAYER_GAP = 0.015
"""m: a surface this far before another one that is seen right beside it is a front layer, such as a cup's near rim."""
_LAYER_REACH = 0.008
"""m across the view in which the two layers are looked for: a depth camera is blind for some pixels between them."""
RIM = 0.006
"""m inside a silhouette over which cameras that match windows mix the object with what lies behind it."""
CELL = 0.003
"""m: side of a cell of the footprint."""
_AROUND = 14
"""Cells of the footprint around the object."""
_LAYER = 0.004
"""m: points of a cell this far below its highest one belong to the same surface."""
_MOST_POINTS = 5000
"""Of the cloud that is looked at for roundness."""
_CONE = 11
"""Cells about a cell that a ray may cross before it meets the surface."""


class Surface(NamedTuple):
    """The plane n . p = d that each pixel of an image (h, w) stands for, and the point seen; base frame, float32.

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
        surface: what was seen there, smoothed; where neither the object nor something else is seen, that of the
            nearest object pixel.
        front: that of the nearest pixel of the object's front layers; NOWHERE without any.
        distances: (h, w) float32, px, to the pixel that `surface` was taken from.
        rims: (h, w) float32, how near the silhouette `surface` was taken: 1 on it, falling off over RIM.
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
        inside: m to the nearest cell without.
        outward_x, outward_y: unit vector from here towards it.
        low, high: m above the table, the lowest and the highest that the surface can be here, equal where it was seen.
        facing: cosine of its slope.
        nearby: m above the table, the highest that it can be nearby.
        hidden: bool, whether `low` and `high` differ anywhere nearby.
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
    hull: NDArray[np.float32]
    x_axis: Array
    y_axis: Array
    corner: Array


@dataclass(frozen=True, eq=False)
class CameraModel:
    """One scene's surface, in base as the camera puts it.

    Attributes:
        free_turn: (6,), the correction by which the object turns about the vertical by 1 rad, if it looks so round
            that nothing tells how far it is turned.
    """

    scene: Scene
    pixels: Pixels
    footprint: Footprint
    noise: CameraNoise
    free_turn: Array | None


def build(scene: Scene) -> CameraModel:
    """The model of one scene; about 60 ms for a scene cropped around its object."""
    metres = np.ascontiguousarray(scene.depth.metres, dtype=np.float64)
    noise = camera_noise(scene)
    camera, mask = scene.camera, scene.mask
    near_table = np.abs(scene.table.height(scene.organised)) < _TABLE_BAND + 3 * noise.pixel
    kind = np.select([mask, metres <= 0, near_table], [OBJECT, UNSEEN, TABLE], OTHER)
    px_per_m = camera.fx / float(np.median(metres[mask]))
    stride = max(1, round(_FIT_RADIUS * px_per_m / _MAX_STEPS))
    steps = max(2, round(_FIT_RADIUS * px_per_m / stride))
    solid = (kind == OBJECT) | (kind == OTHER)
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    depth, normals = fit_planes(metres, solid, intrinsics, steps, stride, _FIT_BAND)
    points = scene.base_T_camera.apply(camera.organised(depth))
    normals = scene.base_T_camera.rotate(normals)
    offsets = np.einsum("ijk,ijk->ij", normals, points)
    distance, nearest = _nearest(mask)
    inside = ndimage.distance_transform_edt(mask) / px_per_m
    rims = np.where(mask, np.exp(-inside / RIM), 0.0)[tuple(nearest)]
    own = kind == OTHER
    rims[own] = 0.0
    nearest[:, own], distance[own] = np.indices(mask.shape)[:, own], 0.0
    layers = _front_layers(metres, mask, round(_LAYER_REACH * px_per_m))
    pixels = Pixels(
        _taken(normals, offsets, points, nearest),
        _taken(normals, offsets, points, _nearest(layers)[1]) if layers.any() else _nowhere(mask.shape),
        _single(distance),
        _single(rims),
        np.ascontiguousarray(kind, dtype=np.int8),
    )
    footprint = _footprint(scene, points[mask], metres, kind)
    return CameraModel(scene, pixels, footprint, noise, _free_turn(scene))


def _free_turn(scene: Scene) -> Array | None:
    """`CameraModel.free_turn`."""
    cloud, up = scene.cloud, scene.table.normal
    found = revolution_about(cloud[:: -(-len(cloud) // _MOST_POINTS)], up)
    if found is None or not found.certain:
        return None
    return np.concatenate([up, np.cross(up, scene.centroid - found.point)])


def _taken(normals: Array, offsets: Array, points: Array, nearest: NDArray[np.int32]) -> Surface:
    """That of the pixels (v, u) (2, h, w) in each pixel's place."""
    v, u = nearest
    return Surface(_single(normals[v, u]), _single(offsets[v, u]), _single(points[v, u]))


def _nowhere(shape: tuple[int, ...]) -> Surface:
    """A surface far from everything in each pixel of an image (h, w)."""
    vectors = np.full((*shape, 3), NOWHERE, dtype=np.float32)
    return Surface(vectors, np.full(shape, NOWHERE, dtype=np.float32), vectors)


def _single(values: Array) -> NDArray[np.float32]:
    return np.ascontiguousarray(values, dtype=np.float32)


def _nearest(mask: NDArray[np.bool_]) -> tuple[Array, NDArray[np.int32]]:
    """Distance (h, w), px, to the mask's nearest pixel, and that pixel's (v, u) (2, h, w)."""
    distance, nearest = ndimage.distance_transform_edt(~mask, return_indices=True)
    return distance, nearest


def _front_layers(metres: Array, mask: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """(h, w) True on object pixels within `reach` pixels of others that lie behind them by more than _LAYER_GAP."""
    farthest = ndimage.maximum_filter(np.where(mask, metres, 0.0), size=2 * reach + 1)
    return np.asarray(mask & (farthest - metres > _LAYER_GAP))


def _footprint(scene: Scene, points: Array, metres: Array, kind: NDArray[np.int64]) -> Footprint:
    """The object's surface points (n, 3) from above."""
    axes = scene.table.frame().rotation
    xy = points @ axes[:, :2]
    corner = xy.min(axis=0) - _AROUND * CELL
    cells = np.floor((xy - corner) / CELL).astype(np.int64)
    top = np.full(tuple(cells.max(axis=0) + _AROUND + 1), -1.0)
    np.maximum.at(top, tuple(cells.T), scene.table.height(points))
    seen = top >= 0
    closed = ndimage.binary_closing(seen, iterations=1)
    _, nearest = ndimage.distance_transform_edt(~seen, return_indices=True)
    top = np.where(closed, top[nearest[0], nearest[1]], -1.0)
    inside, edge = ndimage.distance_transform_edt(closed, return_indices=True)
    outward = (edge - np.indices(closed.shape)) / np.maximum(inside, 1e-9)
    upper = _upper_mean(top, cells, scene.table.height(points))
    upper = np.where(top >= 0, upper, _neighbours(scene, axes, corner, top.shape, kind))
    low, high = _heights(scene, upper, axes, corner, metres, kind)
    smooth = ndimage.gaussian_filter(low, 1.0)
    slope = np.hypot(*np.gradient(smooth, CELL))
    facing = 1.0 / np.sqrt(1.0 + slope**2)
    nearby = ndimage.maximum_filter(high, size=2 * _CONE + 1)
    hidden = ndimage.maximum_filter(high - low, size=2 * _CONE + 1) > 0.0
    return Footprint(
        _single(top),
        _single(inside * CELL),
        _single(outward[0]),
        _single(outward[1]),
        _single(low),
        _single(high),
        _single(facing),
        _single(nearby),
        hidden,
        _single(_hull(seen)),
        axes[:, 0].copy(),
        axes[:, 1].copy(),
        corner,
    )


def _neighbours(scene: Scene, axes: Array, corner: Array, shape: tuple[int, ...], kind: NDArray[np.int64]) -> Array:
    """(nx, ny) m above the table, of what else stands there; below 0 where nothing does.

    Strips of fewer than three pixels are left out: mixed pixels at silhouettes.
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


def _hull(seen: NDArray[np.bool_]) -> Array:
    """(nx, ny) 1 on the cells within the convex hull of those `seen`; of fewer than three or of a line, these alone."""
    cells = np.argwhere(seen)
    try:
        equations = ConvexHull(cells).equations
    except QhullError:
        return seen.astype(np.float64)
    places = np.indices(seen.shape).reshape(2, -1)
    within = (equations[:, :2] @ places + equations[:, 2:] <= 1e-9).all(axis=0)
    return within.reshape(seen.shape).astype(np.float64)


def _upper_mean(top: Array, cells: NDArray[np.int64], heights: Array) -> Array:
    """Mean height of the points near each cell's highest one, where there are any; else `top`: noise raises the top."""
    near = heights > top[tuple(cells.T)] - _LAYER
    total, count = np.zeros(top.shape), np.zeros(top.shape)
    np.add.at(total, tuple(cells[near].T), heights[near])
    np.add.at(count, tuple(cells[near].T), 1.0)
    return np.where(count > 0, total / np.maximum(count, 1.0), top)


def _heights(
    scene: Scene, top: Array, axes: Array, corner: Array, metres: Array, kind: NDArray[np.int64]
) -> tuple[Array, Array]:
    """The lowest and the highest, m above the table, that the surface can be over each cell of `top` (nx, ny).

    Where the camera saw the object they are its height; where it saw the table, 0; in the object's shadow, anything
    up to the sight line that passes over it.
    """
    low = np.maximum(top, 0.0)
    high = low.copy()
    i, j = np.nonzero(top < 0)
    across = corner + (np.stack([i, j], axis=1) + 0.5) * CELL
    foot = axes[:, :2] @ across.T
    foot = foot.T + scene.table.normal * (scene.table.offset - foot.T @ scene.table.normal)[:, None]
    inverse = scene.base_T_camera.inverse()
    open_ = np.ones(len(i), dtype=bool)
    bound = np.zeros(len(i))
    for height in np.arange(0.0, float(top.max()) + CELL, CELL):
        seen = inverse.apply(foot[open_] + height * scene.table.normal)
        u, v = np.round(scene.camera.project(seen)).astype(np.int64).T
        inside = (u >= 0) & (v >= 0) & (u < metres.shape[1]) & (v < metres.shape[0])
        u, v = np.where(inside, u, 0), np.where(inside, v, 0)
        behind = inside & ((kind[v, u] == OBJECT) | (kind[v, u] == OTHER)) & (seen[:, 2] > metres[v, u] + 0.004)
        still = np.flatnonzero(open_)
        bound[still[behind]] = height
        open_[still[~behind]] = False
        if not open_.any():
            break
    high[i, j] = np.maximum(high[i, j], bound)
    return low, high
