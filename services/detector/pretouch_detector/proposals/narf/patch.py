"""The surface about a keypoint as seen along its normal: a small height map in the normal's own frame."""

from __future__ import annotations

import numpy as np
from numba import njit

from pretouch_detector.proposals.narf.moments import COUNT, MOMENTS, add_point, compute_axes, dot, normalise
from pretouch_detector.proposals.narf.range_image import Floats
from pretouch_detector.proposals.narf.surface import fit_plane

CELLS = 10
"""Cells along a side of the projected patch; the blurred one has twice as many."""
_FEW_POINTS, _FEW_NEAREST = 10, 15
_MIN_RINGS = 2
_SLACK = 0.01
_BEYOND = np.float32(0.6)
_ZERO, _ONE, _HALF = np.float32(0), np.float32(1), np.float32(0.5)
_INF = np.float32(np.inf)


@njit(cache=True, nogil=True, error_model="numpy")
def locate_on_ring(radius: int, k: int) -> tuple[int, int]:
    """(dv, du) of the k-th of the 8 x radius pixels around a pixel, clockwise from the upper left; radius 0: itself."""
    if k <= 2 * radius:
        return -radius, k - radius
    if k <= 4 * radius:
        return k - 3 * radius, radius
    if k <= 6 * radius:
        return radius, 5 * radius - k
    return 7 * radius - k, -radius


@njit(cache=True, nogil=True, error_model="numpy")
def compute_upright_frame(points: Floats, ranges: Floats, v: int, u: int, support: np.float32, pose: Floats) -> bool:
    """Writes `patch_T_camera` (3, 4) of pixel (v, u) to `pose`: z along the normal away from the camera, y down.

    The normal is that of the points within half of `support`, m, the further ones counting more; the origin lies on
    their plane. False, and nothing is written, where too few points are near.
    """
    h, w = ranges.shape
    point = points[v, u]
    reach = _HALF * support
    square_reach, inverse_reach = reach * reach, _ONE / reach
    moments = np.zeros(MOMENTS, np.float32)
    radius, near = 1, True
    while near:
        near = False
        for k in range(8 * radius):
            dv, du = locate_on_ring(radius, k)
            j, i = v + dv, u + du
            if j < 0 or j >= h or i < 0 or i >= w or not np.isfinite(ranges[j, i]):
                continue
            x, y, z = points[j, i, 0] - point[0], points[j, i, 1] - point[1], points[j, i, 2] - point[2]
            square = x * x + (y * y + z * z)
            if square <= square_reach:
                near = True
                add_point(moments, points[j, i], np.sqrt(square) * inverse_reach)
        radius += 1
    normal, mean = np.empty(3, np.float32), np.empty(3, np.float32)
    if moments[COUNT] > _FEW_POINTS:
        values, vectors = np.empty(3, np.float32), np.empty((3, 3), np.float32)
        compute_axes(moments, values, vectors)
        normal[:], mean[:] = vectors[0], moments[:3]
        if dot(normal, mean) < _ZERO:
            normal[:] = -normal
    elif np.isnan(fit_plane(points, ranges, v, u, point, _FEW_NEAREST, normal, mean)):
        return False
    offset = dot(normal, mean) - dot(normal, point)
    across = np.empty(3, np.float32)
    across[0], across[1], across[2] = normal[2], _ZERO, -normal[0]
    normalise(across)
    pose[0, 0], pose[0, 1], pose[0, 2] = across[0], across[1], across[2]
    pose[1, 0] = normal[1] * across[2] - normal[2] * across[1]
    pose[1, 1] = normal[2] * across[0] - normal[0] * across[2]
    pose[1, 2] = normal[0] * across[1] - normal[1] * across[0]
    normalise(pose[1, :3])
    pose[2, 0], pose[2, 1], pose[2, 2] = normal[0], normal[1], normal[2]
    normalise(pose[2, :3])
    origin = offset * normal + point
    for k in range(3):
        pose[k, 3] = -(pose[k, 0] * origin[0] + pose[k, 1] * origin[1] + pose[k, 2] * origin[2])
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def render_patch(points: Floats, ranges: Floats, optics: Floats, pose: Floats, support: np.float32) -> Floats:
    """(CELLS, CELLS) z, m, of the nearest surface in the frame `pose` (3, 4), over `support` m each way.

    Between pixels the surface is a mesh of triangles. inf where the background is seen beside it, -inf where nothing is
    known.
    """
    h, w = ranges.shape
    patch = np.full((CELLS, CELLS), -_INF, np.float32)
    origin = np.empty(3, np.float32)
    for k in range(3):
        origin[k] = -(pose[0, k] * pose[0, 3] + pose[1, k] * pose[1, 3] + pose[2, k] * pose[2, 3])
    v, u, _ = _project(origin, optics)
    reach = _HALF * support
    corners = np.empty((3, 3), np.float32)
    radius, near = 0, True
    while near:
        near = radius < _MIN_RINGS
        for k in range(max(1, 8 * radius)):
            dv, du = locate_on_ring(radius, k)
            j, i = v + dv, u + du
            if j < 0 or j + 1 >= h or i < 0 or i + 1 >= w:
                continue
            if not (np.isfinite(ranges[j, i]) and np.isfinite(ranges[j + 1, i + 1])):
                continue
            _transform_to_patch(pose, points[j, i], corners[0])
            _transform_to_patch(pose, points[j + 1, i + 1], corners[1])
            if abs(corners[0, 2]) > reach or abs(corners[1, 2]) > reach:
                continue
            for half in range(2):
                jj, ii = j + 1 - half, i + half
                if np.isfinite(ranges[jj, ii]):
                    _transform_to_patch(pose, points[jj, ii], corners[2])
                    if abs(corners[2, 2]) <= reach and _may_overlap_patch(corners, reach):
                        near = True
                        _draw_triangle(corners, patch, support)
        radius += 1
    _mark_background(ranges, optics, pose, patch, support)
    return patch


@njit(cache=True, nogil=True, error_model="numpy")
def _project(point: Floats, optics: Floats) -> tuple[int, int, np.float32]:
    """Row and column of the pixel that a point (3,) in the camera frame falls on, and its range, m."""
    # PCL multiplies with the focal length, of which `optics` holds the reciprocal
    focal_u, focal_v = _ONE / optics[0], _ONE / optics[1]
    u = optics[2] + focal_u * point[0] / point[2]
    v = optics[3] + focal_v * point[1] / point[2]
    return int(np.rint(v)), int(np.rint(u)), np.sqrt(dot(point, point))


@njit(cache=True, nogil=True, error_model="numpy")
def _transform_to_patch(pose: Floats, point: Floats, out: Floats) -> None:
    for k in range(3):
        out[k] = pose[k, 0] * point[0] + pose[k, 1] * point[1] + pose[k, 2] * point[2] + pose[k, 3]


@njit(cache=True, nogil=True, error_model="numpy")
def _may_overlap_patch(corners: Floats, reach: np.float32) -> bool:
    """Whether the triangle does not lie on the far side of one of the patch's edges."""
    for axis in range(2):
        least = min(corners[0, axis], corners[1, axis], corners[2, axis])
        most = max(corners[0, axis], corners[1, axis], corners[2, axis])
        if most < -reach or least > reach:
            return False
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _draw_triangle(corners: Floats, patch: Floats, support: np.float32) -> None:
    """Writes the heights of a triangle's plane into the cells whose centres it covers, keeping the nearer surface."""
    scale = _ONE / (support / np.float32(CELLS))
    middle = _HALF * np.float32(CELLS) - _HALF
    x0, y0, z0 = scale * corners[0, 0] + middle, scale * corners[0, 1] + middle, corners[0, 2]
    x1, y1, z1 = scale * corners[1, 0] + middle, scale * corners[1, 1] + middle, corners[1, 2]
    x2, y2, z2 = scale * corners[2, 0] + middle, scale * corners[2, 1] + middle, corners[2, 2]
    left, right = max(0, int(np.ceil(min(x0, x1, x2)))), min(CELLS - 1, int(np.floor(max(x0, x1, x2))))
    top, bottom = max(0, int(np.ceil(min(y0, y1, y2)))), min(CELLS - 1, int(np.floor(max(y0, y1, y2))))
    ax, ay, bx, by = x2 - x0, y2 - y0, x1 - x0, y1 - y0
    aa, ab, bb = ax * ax + ay * ay, ax * bx + ay * by, bx * bx + by * by
    inverse = _ONE / (aa * bb - ab * ab)
    for column in range(left, right + 1):
        for row in range(top, bottom + 1):
            cx, cy = np.float32(column) - x0, np.float32(row) - y0
            ac, bc = ax * cx + ay * cy, bx * cx + by * cy
            s, t = (bb * ac - ab * bc) * inverse, (aa * bc - ab * ac) * inverse
            if s > -_SLACK and t >= -_SLACK and s + t <= 1 + _SLACK:
                height = z0 + s * (z2 - z0) + t * (z1 - z0)
                known = np.isfinite(patch[row, column])
                patch[row, column] = min(patch[row, column], height) if known else height


@njit(cache=True, nogil=True, error_model="numpy")
def _mark_background(ranges: Floats, optics: Floats, pose: Floats, patch: Floats, support: np.float32) -> None:
    """Sets cells without a surface, and those around them, to inf where the camera sees the background there."""
    h, w = ranges.shape
    size = support / np.float32(CELLS)
    reach = _HALF * support
    corner = -reach + _HALF * size
    point, offset = np.empty(3, np.float32), np.empty(3, np.float32)
    for row in range(CELLS):
        for column in range(CELLS):
            if np.isfinite(patch[row, column]):
                continue
            background = False
            for j in range(max(0, row - 1), min(CELLS, row + 2)):
                for i in range(max(0, column - 1), min(CELLS, column + 2)):
                    if background or not np.isfinite(patch[j, i]):
                        continue
                    offset[0] = size * (np.float32(column) + _BEYOND * np.float32(column - i)) + corner - pose[0, 3]
                    offset[1] = size * (np.float32(row) + _BEYOND * np.float32(row - j)) + corner - pose[1, 3]
                    offset[2] = patch[j, i] - pose[2, 3]
                    for k in range(3):
                        point[k] = pose[0, k] * offset[0] + pose[1, k] * offset[1] + pose[2, k] * offset[2]
                    v, u, distance = _project(point, optics)
                    if 0 <= v < h and 0 <= u < w and ranges[v, u] - distance > reach:
                        background = True
            if background:
                for j in range(max(0, row - 1), min(CELLS, row + 2)):
                    for i in range(max(0, column - 1), min(CELLS, column + 2)):
                        if not np.isfinite(patch[j, i]):
                            patch[j, i] = _INF
