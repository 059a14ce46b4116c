"""What the camera saw, ready to be asked: smoothed surface, kind of each pixel, way to the nearest edge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from pretouch.geometry import Array
from pretouch.scene import Scene

UNSEEN, OBJECT, TABLE = 0, 1, 2
"""Kinds of a pixel; `UNSEEN` is evidence for nothing: no depth, another object, or the object's shadow."""

_FIT_RADIUS = 0.005
"""m on the surface: half width of a plane fit; about three pixels of a Kinect at 0.9 m."""
_FIT_BAND = 0.0035
"""m: residual at which a neighbour counts little in a plane fit."""
_MAX_STEPS = 4
"""Neighbours on each side of a plane fit; wider windows are thinned out to this many."""


PLANE, POINT, TO_OBJECT, KIND = 0, 4, 7, 8
"""Where a pixel's fields begin, see `CameraModel.pixels`."""
TOP, INSIDE, OUTWARD = 0, 1, 2
"""Where a cell's fields begin, see `CameraModel.footprint`."""
CELL = 0.003
"""m: side of a cell of the footprint."""


@dataclass(frozen=True, eq=False)
class CameraModel:
    """One scene's surface, in base as the camera puts it.

    Attributes:
        pixels: (h, w, 9) float32. Per pixel: the plane n . p = d of the nearest object pixel's smoothed surface (n
            towards the camera, d in m); that surface's point (3), m; distance to that pixel, px; the pixel's kind.
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
    camera = scene.camera
    radius_px = _FIT_RADIUS * camera.fx / float(np.median(metres[scene.mask]))
    stride = max(1, round(radius_px / _MAX_STEPS))
    steps = max(2, round(radius_px / stride))
    depth, normals = _fit_planes(
        metres, scene.mask, camera.fx, camera.fy, camera.cx, camera.cy, steps, stride, _FIT_BAND
    )
    points = scene.base_T_camera.apply(camera.organised(depth))
    normals = scene.base_T_camera.rotate(normals)
    planes = np.concatenate([normals, np.einsum("ijk,ijk->ij", normals, points)[..., None], points], axis=2)
    noise = 0.0012 + 0.0019 * (metres - 0.4) ** 2
    table = (~scene.mask) & (metres > 0) & (np.abs(scene.table.height(scene.organised)) < 0.003 + 3 * noise)
    distance, nearest = ndimage.distance_transform_edt(~scene.mask, return_indices=True)
    kind = np.where(scene.mask, OBJECT, np.where(table, TABLE, UNSEEN))
    pixels = np.concatenate([planes[nearest[0], nearest[1]], distance[..., None], kind[..., None]], axis=2)
    footprint, frame = _footprint(scene, points[scene.mask])
    return CameraModel(scene, np.ascontiguousarray(pixels, dtype=np.float32), footprint, frame)


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
