"""What the camera saw, ready to be asked: smoothed surface, kind of each pixel, way to the nearest edge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from pretouch.geometry import Array
from pretouch.scene import Scene

UNSEEN, OBJECT, TABLE, OTHER = 0, 1, 2, 3
"""Kinds of a pixel: no depth, the object, the table, or something else that stands about."""

_FIT_RADIUS = 0.005
"""m on the surface: half width of a plane fit; about three pixels of a Kinect at 0.9 m."""
_FIT_BAND = 0.0035
"""m: residual at which a neighbour counts little in a plane fit."""
_MAX_STEPS = 4
"""Neighbours on each side of a plane fit; wider windows are thinned out to this many."""


PLANE, POINT, FRONT_PLANE, FRONT_POINT, TO_SURFACE, KIND = 0, 4, 7, 11, 14, 15
"""Where a pixel's fields begin, see `CameraModel.pixels`."""
NOWHERE = 1e6
"""m: plane and point of a front layer where there is none; finite, since the kernels know no infinity."""
_LAYER_GAP = 0.015
"""m: a surface this far before another one that is seen right beside it is a front layer, such as a cup's near rim."""
_LAYER_REACH = 0.008
"""m across the view in which the two layers are looked for: a depth camera is blind for some pixels between them."""
TOP, INSIDE, OUTWARD = 0, 1, 2
"""Where a cell's fields begin, see `CameraModel.footprint`."""
CELL = 0.003
"""m: side of a cell of the footprint."""


@dataclass(frozen=True, eq=False)
class CameraModel:
    """One scene's surface, in base as the camera puts it.

    Attributes:
        pixels: (h, w, 16) float32. Per pixel: the plane n . p = d of the surface seen there, smoothed (n towards the
            camera, d in m), and its point (3), m; where neither the object nor something else is seen, those of the
            nearest object pixel; plane and point of the nearest pixel of the object's front layers,
            NOWHERE without any; distance to the pixel that the plane was taken from, px; the pixel's kind.
        footprint: (nx, ny, 4) float32, the object seen from above in cells of the table's plane. Per cell: height of
            the highest seen point above the table, m, below 0 where there is none; distance to the nearest cell
            without, m; unit vector (x, y) from here towards it.
        frame: (8,): the table's x axis (3) and y axis (3) in base, and the footprint's first corner (x, y), m.
    """

    scene: Scene
    pixels: NDArray[np.float32]
    footprint: NDArray[np.float32]
    frame: Array


def build(scene: Scene) -> CameraModel:
    """The model of one scene; about 20 ms for a scene cropped around its object."""
    metres = np.ascontiguousarray(scene.depth.metres, dtype=np.float64)
    camera, mask = scene.camera, scene.mask
    noise = 0.0012 + 0.0019 * (metres - 0.4) ** 2
    near_table = np.abs(scene.table.height(scene.organised)) < 0.003 + 3 * noise
    kind = np.select([mask, metres <= 0, near_table], [OBJECT, UNSEEN, TABLE], OTHER)
    px_per_m = camera.fx / float(np.median(metres[mask]))
    stride = max(1, round(_FIT_RADIUS * px_per_m / _MAX_STEPS))
    steps = max(2, round(_FIT_RADIUS * px_per_m / stride))
    solid = (kind == OBJECT) | (kind == OTHER)
    depth, normals = _fit_planes(metres, solid, camera.fx, camera.fy, camera.cx, camera.cy, steps, stride, _FIT_BAND)
    points = scene.base_T_camera.apply(camera.organised(depth))
    normals = scene.base_T_camera.rotate(normals)
    surface = np.concatenate([normals, np.einsum("ijk,ijk->ij", normals, points)[..., None], points], axis=2)
    distance, nearest = _nearest(mask)
    own = kind == OTHER
    nearest[:, own], distance[own] = np.indices(mask.shape)[:, own], 0.0
    layers = _front_layers(metres, mask, round(_LAYER_REACH * px_per_m))
    front = surface[tuple(_nearest(layers)[1])] if layers.any() else np.full(surface.shape, NOWHERE)
    fields = [surface[tuple(nearest)], front, distance[..., None], kind[..., None]]
    footprint, frame = _footprint(scene, points[mask])
    return CameraModel(scene, np.ascontiguousarray(np.concatenate(fields, axis=2), dtype=np.float32), footprint, frame)


def _nearest(mask: NDArray[np.bool_]) -> tuple[Array, NDArray[np.int32]]:
    """Distance (h, w), px, to the mask's nearest pixel, and that pixel's (v, u) (2, h, w)."""
    distance, nearest = ndimage.distance_transform_edt(~mask, return_indices=True)
    return distance, nearest


def _front_layers(metres: Array, mask: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """(h, w) True on object pixels within `reach` pixels of others that lie behind them by more than _LAYER_GAP."""
    farthest = ndimage.maximum_filter(np.where(mask, metres, 0.0), size=2 * reach + 1)
    return np.asarray(mask & (farthest - metres > _LAYER_GAP))


def _footprint(scene: Scene, points: Array) -> tuple[NDArray[np.float32], Array]:
    """The object's surface points (n, 3) from above, as `CameraModel.footprint` and `CameraModel.frame`."""
    axes = scene.table.frame().rotation
    xy = points @ axes[:, :2]
    corner = xy.min(axis=0) - 4 * CELL
    cells = np.floor((xy - corner) / CELL).astype(np.int64)
    top = np.full(tuple(cells.max(axis=0) + 5), -1.0)
    np.maximum.at(top, tuple(cells.T), scene.table.height(points))
    seen = top >= 0
    closed = ndimage.binary_closing(seen, iterations=1)
    _, nearest = ndimage.distance_transform_edt(~seen, return_indices=True)
    top = np.where(closed, top[nearest[0], nearest[1]], -1.0)
    inside, edge = ndimage.distance_transform_edt(closed, return_indices=True)
    outward = np.moveaxis(edge - np.indices(closed.shape), 0, 2)
    outward = outward / np.maximum(inside, 1e-9)[..., None]
    fields = np.concatenate([top[..., None], inside[..., None] * CELL, outward], axis=2)
    return np.ascontiguousarray(fields, dtype=np.float32), np.concatenate([axes[:, 0], axes[:, 1], corner])


@njit(cache=True)
def _fit_planes(
    metres: Array,
    mask: NDArray[np.bool_],
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    steps: int,
    stride: int,
    band: float,
) -> tuple[Array, Array]:
    """Robust plane fits around each object pixel: its smoothed depth (h, w) and normal (h, w, 3), camera frame.

    A plane is linear in inverse depth over the image, 1/z = a u + b v + c, and a disparity camera's noise is constant
    there; three rounds of weighted least squares, weights by distance and by residual.
    """
    h, w = metres.shape
    depth = metres.copy()
    normals = np.zeros((h, w, 3))
    for i in range(h):
        for j in range(w):
            if not mask[i, j]:
                continue
            z0 = metres[i, j]
            a, b, c = 0.0, 0.0, 1.0 / z0
            band_inverse = band / (z0 * z0)
            for turn in range(3):
                limit = band_inverse * (2.5 if turn == 0 else 1.0)
                s = suu = svv = suv = su = sv = sy = suy = svy = 0.0
                for di in range(-steps, steps + 1):
                    y = i + di * stride
                    if y < 0 or y >= h:
                        continue
                    for dj in range(-steps, steps + 1):
                        x = j + dj * stride
                        if x < 0 or x >= w or not mask[y, x]:
                            continue
                        u, v = float(dj * stride), float(di * stride)
                        value = 1.0 / metres[y, x]
                        residual = (value - (a * u + b * v + c)) / limit
                        q = residual * residual
                        if q > 9.0:
                            continue
                        weight = np.exp(-0.5 * q - 1.4 * (di * di + dj * dj) / (steps * steps))
                        s += weight
                        su += weight * u
                        sv += weight * v
                        suu += weight * u * u
                        svv += weight * v * v
                        suv += weight * u * v
                        sy += weight * value
                        suy += weight * u * value
                        svy += weight * v * value
                if s < 2.5:
                    break
                mu, mv, my = su / s, sv / s, sy / s
                cuu = suu / s - mu * mu + 0.02 * stride * stride
                cvv = svv / s - mv * mv + 0.02 * stride * stride
                cuv = suv / s - mu * mv
                cuy = suy / s - mu * my
                cvy = svy / s - mv * my
                det = cuu * cvv - cuv * cuv
                if det < 1e-9:
                    break
                a = (cuy * cvv - cvy * cuv) / det
                b = (cvy * cuu - cuy * cuv) / det
                c = my - a * mu - b * mv
            if c > 0 and abs(1.0 / c - z0) < 0.015 * z0:
                depth[i, j] = 1.0 / c
            nx = a * fx
            ny = b * fy
            nz = c + a * (cx - j) + b * (cy - i)
            norm = np.sqrt(nx * nx + ny * ny + nz * nz)
            if norm < 1e-12:
                nz, norm = 1.0, 1.0
            normals[i, j, 0] = -nx / norm
            normals[i, j, 1] = -ny / norm
            normals[i, j, 2] = -nz / norm
    return depth, normals
