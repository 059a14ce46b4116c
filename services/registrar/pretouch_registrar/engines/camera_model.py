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


PLANE, TO_OBJECT, OBJECT_WAY, TO_TABLE, TABLE_WAY, KIND = 0, 4, 5, 7, 8, 10
"""Where a pixel's fields begin, see `CameraModel.pixels`."""
EDGE_SLACK_PX = 0.7
"""A silhouette is known to about this many pixels: lateral distances below it count as none."""


@dataclass(frozen=True, eq=False)
class CameraModel:
    """One scene's surface, in base as the camera puts it.

    Attributes:
        pixels: (h, w, 11) float32. Per pixel: the plane n . p = d of the nearest object pixel's smoothed surface (n
            towards the camera, d in m); lateral distance to that pixel, px beyond EDGE_SLACK_PX, and the unit vector
            (u, v) from it; the same distance and vector for the nearest table pixel; the pixel's kind.
    """

    scene: Scene
    pixels: NDArray[np.float32]


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
    planes = np.concatenate([normals, np.einsum("ijk,ijk->ij", normals, points)[..., None]], axis=2)
    noise = 0.0012 + 0.0019 * (metres - 0.4) ** 2
    table = (~scene.mask) & (metres > 0) & (np.abs(scene.table.height(scene.organised)) < 0.003 + 3 * noise)
    to_object, nearest = _nearest(scene.mask)
    to_table, _ = _nearest(table)
    kind = np.where(scene.mask, OBJECT, np.where(table, TABLE, UNSEEN))
    pixels = np.concatenate([planes[nearest[0], nearest[1]], to_object, to_table, kind[..., None]], axis=2)
    return CameraModel(scene, np.ascontiguousarray(pixels, dtype=np.float32))


def _nearest(mask: NDArray[np.bool_]) -> tuple[Array, NDArray[np.int32]]:
    """Distance and unit vector (u, v) from the mask's nearest pixel (h, w, 3), and that pixel's (v, u) (2, h, w)."""
    v, u = np.indices(mask.shape)
    if not mask.any():
        nowhere = np.zeros((*mask.shape, 3))
        nowhere[..., 0] = 1e6
        return nowhere, np.stack([v, u])
    distance, nearest = ndimage.distance_transform_edt(~mask, return_indices=True)
    length = np.maximum(distance, 1e-9)
    fields = [np.maximum(distance - EDGE_SLACK_PX, 0), (u - nearest[1]) / length, (v - nearest[0]) / length]
    return np.stack(fields, axis=2), nearest


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
