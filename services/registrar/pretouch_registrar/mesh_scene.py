"""Renders a mesh as a scene: without noise, by a virtual camera far above it, along the finger's beams.

From there on a known shape is treated like one that a real camera saw.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch.camera import Camera, DepthImage
from pretouch.cancellation import check_cancelled
from pretouch.errors import InvalidInput
from pretouch.geometry import Array, Pose
from pretouch.mesh_target import MeshTarget
from pretouch.scene import MIN_OBJECT_PIXELS, Scene

_DISTANCE = 3.0
"""m from the camera to the object's highest point: from so far, the object hides hardly any of the table."""
_MARGIN = 0.06
"""m of table around the object: more than three standard deviations of the default prior."""
_FINEST, _COARSEST = 0.0004, 0.001
"""m: bounds of a pixel's side at the object's top; between them _PIXELS_ACROSS pixels lie across the object."""
_PIXELS_ACROSS = 100
_MAX_PIXELS_ACROSS = 700
"""Pixels across the image, however large the object."""
_MAX_VISITS = 1_000_000_000
"""Pixels that the triangles' bounding boxes may cover in all; they take some seconds."""
_VISITS_AT_ONCE = 30_000_000
"""The same between two looks at whether anybody still waits."""


def mesh_scene(target: MeshTarget) -> Scene:
    """The scene of a mesh on its table, by a z-buffer in inverse depth, which is linear over the image.

    Raises:
        InvalidInput: less than MIN_OBJECT_PIXELS pixels of it rise above the table, or its triangles cover each other
            thousands of times.
    """
    vertices = target.base_T_object.apply(target.vertices)
    referenced = np.zeros(len(vertices), dtype=bool)
    referenced[target.faces] = True
    axes = target.table.frame().rotation
    in_table_axes = vertices[referenced] @ axes
    low, high = in_table_axes.min(axis=0), in_table_axes.max(axis=0)
    span = float((high - low)[:2].max())
    pixel = max(float(np.clip(span / _PIXELS_ACROSS, _FINEST, _COARSEST)), (span + 2 * _MARGIN) / _MAX_PIXELS_ACROSS)
    size = np.ceil(((high - low)[:2] + 2 * _MARGIN) / pixel).astype(np.int64) + 1
    middle = (low + high) / 2
    base_T_camera = Pose.of(axes @ np.diag([1.0, -1.0, -1.0]), axes @ [middle[0], middle[1], high[2] + _DISTANCE])
    focal = _DISTANCE / pixel
    camera = Camera(focal, focal, (size[0] - 1) / 2, (size[1] - 1) / 2)
    if high[2] <= target.table.offset:
        raise InvalidInput("All of the mesh lies below the table.", "Check base_T_object, the table and its normal.")
    table_inverse = 1.0 / (high[2] + _DISTANCE - target.table.offset)
    inverse = np.full((size[1], size[0]), table_inverse)
    seen = base_T_camera.inverse().apply(vertices)
    uvw = np.concatenate([camera.project(seen), 1.0 / seen[:, 2:]], axis=1)
    face = visits = 0
    while face < len(target.faces):
        check_cancelled()
        face, visited = _rasterise(uvw, target.faces, face, inverse, _VISITS_AT_ONCE)
        visits += visited
        if visits > _MAX_VISITS:
            raise InvalidInput("The mesh's triangles cover each other too many times.", "Simplify the mesh.")
    mask = inverse > table_inverse
    if mask.sum() < MIN_OBJECT_PIXELS:
        raise InvalidInput(
            f"From above, the mesh covers {int(mask.sum())} pixels of {1000 * pixel:.1f} mm above the table; at least "
            f"{MIN_OBJECT_PIXELS} are needed.",
            "Check the mesh's units, base_T_object, and that the table's normal points up.",
        )
    return Scene(DepthImage((1.0 / inverse).astype(np.float32)), camera, base_T_camera, mask, target.table)


@njit(cache=True, nogil=True)
def _rasterise(uvw: Array, faces: NDArray[np.int64], start: int, inverse: Array, most_visits: int) -> tuple[int, int]:
    """Draws triangles with corners (u, v, 1/z), rows of `uvw` (n, 3), over `inverse` (h, w): the nearest stays.

    A pixel belongs to a triangle if its centre does. It begins with face `start` and ends after the one with which
    `most_visits` pixels were visited. Returns the next face, and the number of visits.
    """
    height, width = inverse.shape
    visits = 0
    for f in range(start, faces.shape[0]):
        au, av, aw = uvw[faces[f, 0]]
        bu, bv, bw = uvw[faces[f, 1]]
        cu, cv, cw = uvw[faces[f, 2]]
        area = (bu - au) * (cv - av) - (bv - av) * (cu - au)
        if abs(area) < 1e-12:
            continue
        first = max(0, int(np.ceil(min(au, bu, cu))))
        last = min(width - 1, int(np.floor(max(au, bu, cu))))
        top = max(0, int(np.ceil(min(av, bv, cv))))
        bottom = min(height - 1, int(np.floor(max(av, bv, cv))))
        if last < first or bottom < top:
            continue
        visits += (last - first + 1) * (bottom - top + 1)
        for v in range(top, bottom + 1):
            for u in range(first, last + 1):
                a = ((bu - u) * (cv - v) - (bv - v) * (cu - u)) / area
                b = ((cu - u) * (av - v) - (cv - v) * (au - u)) / area
                c = 1.0 - a - b
                if a >= -1e-9 and b >= -1e-9 and c >= -1e-9:
                    w = a * aw + b * bw + c * cw
                    if w > inverse[v, u]:
                        inverse[v, u] = w
        if visits >= most_visits:
            return f + 1, visits
    return faces.shape[0], visits
