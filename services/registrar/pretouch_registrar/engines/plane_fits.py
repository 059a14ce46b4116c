"""Smoothed depth and normals of a depth image by robust plane fits."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch.cancellation import check_cancelled
from pretouch.geometry import Array

_ROWS = 64
"""Rows of an image that are fitted between two looks at whether anybody still waits."""


class Window(NamedTuple):
    """Neighbours of a plane fit.

    Attributes:
        steps, stride: so many pixels to each side, so many pixels apart.
        band: m, the residual at which a neighbour counts little.
    """

    steps: int
    stride: int
    band: float


def fit_planes(metres: Array, mask: NDArray[np.bool_], camera: Array, window: Window) -> tuple[Array, Array]:
    """Robust plane fits around each object pixel: its smoothed depth (h, w) and normal (h, w, 3), camera frame.

    A plane is linear in inverse depth over the image, 1/z = a u + b v + c, and a disparity camera's noise is constant
    there; three rounds of weighted least squares, weights by distance and by residual.

    Args:
        metres, mask: (h, w).
        camera: (4,), fx, fy, cx, cy, px.
    """
    depth, normals = metres.copy(), np.zeros((*metres.shape, 3))
    for first in range(0, len(metres), _ROWS):
        check_cancelled()
        _fit_rows(first, min(first + _ROWS, len(metres)), metres, mask, camera, window, depth, normals)
    return depth, normals


@njit(cache=True, nogil=True)
def _fit_rows(
    first: int, end: int, metres: Array, mask: NDArray[np.bool_], camera: Array, window: Window,
    depth: Array, normals: Array,
) -> None:  # fmt: skip
    """Fills rows `first` to `end` of the depth (h, w) and the normals (h, w, 3); see `fit_planes`."""
    fx, fy, cx, cy = camera
    steps, stride, band = window
    h, w = metres.shape
    for i in range(first, end):
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
