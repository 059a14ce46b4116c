"""Projects points in base into the camera's image, and into the footprint seen from above."""

from __future__ import annotations

import numpy as np
from numba import njit

from pretouch_registrar.engines.camera_model import CELL, Footprint
from pretouch_registrar.engines.correction import Vector
from pretouch_registrar.engines.registration_problem import Optics, Table

_CELLS_PER_M = 1.0 / CELL


@njit(cache=True, nogil=True, inline="always")
def project(point: Vector, optics: Optics) -> tuple[float, float, float]:
    """(u, v, depth) of a point in base, px and m; all 0 where it is not at least 1 mm in front of the camera."""
    r, position = optics.rotation, optics.position
    x, y, z = point[0] - position[0], point[1] - position[1], point[2] - position[2]
    depth = r[0, 2] * x + r[1, 2] * y + r[2, 2] * z
    if depth < 1e-3:
        return 0.0, 0.0, 0.0
    u = optics.fx * (r[0, 0] * x + r[1, 0] * y + r[2, 0] * z) / depth + optics.cx
    v = optics.fy * (r[0, 1] * x + r[1, 1] * y + r[2, 1] * z) / depth + optics.cy
    return u, v, depth


@njit(cache=True, nogil=True, inline="always")
def find_pixel(u: float, v: float) -> tuple[int, int]:
    """Row and column of the pixel that contains (u, v), which may lie outside the image."""
    return int(np.floor(v + 0.5)), int(np.floor(u + 0.5))


@njit(cache=True, nogil=True, inline="always")
def compute_height(point: Vector, table: Table) -> float:
    """m: the height of a point above the table."""
    return table.normal[0] * point[0] + table.normal[1] * point[1] + table.normal[2] * point[2] - table.offset


@njit(cache=True, nogil=True, inline="always")
def find_cell(point: Vector, footprint: Footprint) -> tuple[int, int]:
    """The footprint's cell below a point in base; -1, -1 outside."""
    a, b, corner = footprint.x_axis, footprint.y_axis, footprint.corner
    across = (a[0] * point[0] + a[1] * point[1] + a[2] * point[2] - corner[0]) * _CELLS_PER_M
    along = (b[0] * point[0] + b[1] * point[1] + b[2] * point[2] - corner[1]) * _CELLS_PER_M
    if across < 0 or along < 0 or across >= footprint.top.shape[0] or along >= footprint.top.shape[1]:
        return -1, -1
    return int(across), int(along)
