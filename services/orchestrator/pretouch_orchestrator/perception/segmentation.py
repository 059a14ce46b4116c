"""What is the object, and where is its table? From the client's mask and table, or found in the depth image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError

from pretouch.camera import Camera, DepthImage
from pretouch.errors import InvalidInput
from pretouch.geometry import Array, Plane, Pose
from pretouch.scene import MIN_OBJECT_PIXELS, Scene
from pretouch_orchestrator.perception.clusters import clusters, without_flying
from pretouch_orchestrator.perception.table import fit_table, height_std

Pixels = NDArray[np.bool_]

_MIN_HEIGHT = 0.008
"""m: an object rises above the table by this or more."""
_BASE = 0.004
"""m above the table, the mean of 3 x 3 pixels, from which a pixel can belong to an object; or 2 sigma of one pixel."""
_MAX_FOOT = 0.03
"""m: what stands on the table is seen down to this height or lower; what hangs above it is not."""
_EDGE = 0.01
"""m within the outline of the table's seen part that half of an object is or more; a wall behind the table is not."""
_CONSIDERED = 20


def find_object(
    depth: DepthImage,
    camera: Camera,
    base_T_camera: Pose,
    roi: tuple[int, int, int, int] | None = None,
    mask: Pixels | None = None,
    table: Plane | None = None,
) -> Scene:
    """The scene that a client's view shows.

    Args:
        depth: (h, w).
        base_T_camera: extrinsics as the client believes them.
        roi: (u0, v0, u1, v1), half-open: where the object is; with a mask, their intersection counts.
        mask: (h, w), True on the object; None: the largest thing that stands on the table within the roi.
        table: in base as `base_T_camera` puts it; None: the plane that most of the surroundings lie on.

    Raises:
        InvalidInput: no depth, a roi beside the image, a mask of another size or without depth, no table, no object.
    """
    seen = depth.metres > 0
    if not seen.any():
        raise InvalidInput("The depth image holds no depth.", "Send metres = value x depth_scale; 0 means no data.")
    area = _area(depth, roi)
    if mask is not None:
        mask = _checked(mask, area, seen)
    points = camera.organised(depth.metres)
    if table is not None:
        plane = table.moved(base_T_camera.inverse())
    else:
        plane = _found_table(points, seen, area if roi is not None else None, mask)
        table = plane.moved(base_T_camera)
    if mask is None:
        mask = _standing(depth.metres, points, plane, area & seen)
    return Scene(depth, camera, base_T_camera, mask, table)


def _area(depth: DepthImage, roi: tuple[int, int, int, int] | None) -> Pixels:
    area = np.ones(depth.metres.shape, dtype=bool)
    if roi is None:
        return area
    u0, v0, u1, v1 = roi
    if u0 >= depth.width or v0 >= depth.height:
        raise InvalidInput(
            f"roi {list(roi)} lies beside the image of {depth.width} x {depth.height} pixels.",
            "Send [u0, v0, u1, v1] in the depth image's pixels.",
        )
    area[:] = False
    area[v0:v1, u0:u1] = True
    return area


def _checked(mask: Pixels, area: Pixels, seen: Pixels) -> Pixels:
    if mask.shape != seen.shape:
        raise InvalidInput(
            f"The mask is {list(mask.shape)} pixels (h, w), the depth image {list(seen.shape)}.",
            "Send a mask of the depth image's size.",
        )
    if not mask.any():
        raise InvalidInput("The mask is empty.", "Mark the object's pixels with a value other than 0, or send no mask.")
    if not (mask & area).any():
        raise InvalidInput("The mask is empty within the roi.", "Send a roi that holds the object, or none.")
    if not (mask & area & seen).any():
        raise InvalidInput("The depth image has no data within the mask.", "Check that mask and depth image fit.")
    return mask & area


def _found_table(points: Array, seen: Pixels, area: Pixels | None, mask: Pixels | None) -> Plane:
    """The table in the camera frame: from the object's surroundings, else from the whole image."""
    stages = [(seen, 0.0)]
    if mask is not None:
        beside = seen & ~ndimage.binary_dilation(mask, iterations=3)
        stages = [(beside & _grown(mask, 1.0), 0.5), (beside, 0.0)]
    elif area is not None:
        stages = [(seen & _grown(area, 0.5), 0.5), (seen, 0.0)]
    for pixels, below_weight in stages:
        plane = fit_table(points[pixels], below_weight)
        if plane is not None and (mask is None or np.median(plane.height(points[mask & seen])) > 0):
            return plane
    raise InvalidInput(
        "No table was found in the depth image.",
        'Send "table": its unit normal away from the table and its offset, in base, or a view with more of the table.',
    )


def _grown(area: Pixels, share: float) -> Pixels:
    """The bounding box of `area`, larger by `share` of its sides, and 20 pixels or more, at each side."""
    v, u = np.nonzero(area)
    pad_v, pad_u = (max(20, int(share * (np.ptp(x) + 1))) for x in (v, u))
    grown = np.zeros_like(area)
    grown[max(0, v.min() - pad_v) : v.max() + pad_v + 1, max(0, u.min() - pad_u) : u.max() + pad_u + 1] = True
    return grown


def _standing(depth: NDArray[np.float32], points: Array, table: Plane, area: Pixels) -> Pixels:
    """The largest cluster of pixels in `area` that stands on the table (camera frame)."""
    heights = table.height(points)
    std = height_std(points, table.normal)
    flat = np.where(depth > 0, np.clip(heights, -0.02, 0.02), 0.0)
    mean = ndimage.uniform_filter(flat, 3) / np.maximum(ndimage.uniform_filter((depth > 0).astype(np.float64), 3), 0.1)
    above = area & (mean > np.maximum(_BASE, 2 * std)) & (heights > std)
    labels = clusters(depth, without_flying(depth, above))
    table_T_camera = table.frame().inverse()
    outline = _outline(table_T_camera.apply(points)[..., :2], (depth > 0) & (np.abs(heights) < 3 * std + 0.002))
    pixels: Pixels
    for label in range(1, min(int(labels.max()), _CONSIDERED) + 1):
        pixels = labels == label
        if pixels.sum() < MIN_OBJECT_PIXELS:
            break
        foot, top = heights[pixels].min(), np.percentile(heights[pixels], 95)
        over = table_T_camera.apply(points[pixels])[:, :2] @ outline[:, :2].T + outline[:, 2] <= -_EDGE
        if foot < _MAX_FOOT and top > _MIN_HEIGHT and over.all(axis=1).mean() >= 0.5:
            return pixels
    raise InvalidInput(
        "Nothing stands on the table within the view, or within the roi if one was sent.",
        "Send a mask or another roi, and check that the table's normal points towards the camera.",
    )


def _outline(places: Array, table: Pixels) -> Array:
    """The convex outline of the table's large pieces: half planes (m, 3) with a x + b y + c <= 0 inside.

    Args:
        places: (h, w, 2), m, each pixel's (x, y) in the table's frame.
        table: (h, w), pixels at the table's height: the table, and strays where its plane meets other things.
    """
    pieces, _ = ndimage.label(table, structure=np.ones((3, 3)))
    sizes = np.bincount(pieces.ravel())
    sizes[0] = 0
    large = np.isin(pieces, np.flatnonzero(sizes >= max(MIN_OBJECT_PIXELS, 0.1 * sizes.max())))
    try:
        return np.asarray(ConvexHull(places[large]).equations, dtype=np.float64)
    except (QhullError, ValueError):
        return np.zeros((0, 3))
