"""Segments object and table in the depth image, unless the client gives a mask or the table."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError

from pretouch.camera import Camera, DepthImage
from pretouch.errors import InvalidInput
from pretouch.geometry import Array, Plane, Pose
from pretouch.scene import MIN_OBJECT_PIXELS, Scene
from pretouch_orchestrator.perception.clusters import label_clusters, remove_flying_pixels
from pretouch_orchestrator.perception.table import fit_table, height_std

Pixels = NDArray[np.bool_]

_MIN_HEIGHT = 0.008
"""m: least height of an object above the table."""
_MIN_PIXEL_HEIGHT = 0.004
"""m: least height, averaged over 3 x 3 pixels, of a pixel of an object; 2 sigma of one pixel where that is more."""
_MAX_FOOT = 0.03
"""m: the lowest seen point of an object that stands on the table is at most this high."""
_OUTLINE_MARGIN = 0.01
"""m inside the outline of the visible table within which at least half of an object lies, unlike a wall behind it."""
_MAX_CLUSTERS = 20
USUAL_DEPTH = (0.2, 5.0)
"""m: a median depth outside is most often in a wrong unit."""
_MAX_MASK_SHARE = 0.6
"""Share of the depth above which a mask holds more than an object."""


def find_object(
    depth: DepthImage,
    camera: Camera,
    base_T_camera: Pose,
    roi: tuple[int, int, int, int] | None = None,
    mask: Pixels | None = None,
    table: Plane | None = None,
) -> Scene:
    """Segments the client's view.

    Args:
        depth: (h, w).
        base_T_camera: extrinsics as the client believes them.
        roi: (u0, v0, u1, v1), half-open: the object is within it; a mask is intersected with it.
        mask: (h, w), True on the object; None: the largest object that stands on the table within the roi is taken.
        table: in base by `base_T_camera`; None: the plane with the most support around the object is taken.

    Raises:
        InvalidInput: no depth, a roi outside the image, a mask of another size or without depth, no table, no object.
    """
    seen = depth.metres > 0
    if not seen.any():
        raise InvalidInput("The depth image holds no depth.", "Send metres = value x depth_scale; 0 means no data.")
    area = _roi_to_mask(depth, roi)
    if mask is not None:
        mask = _validate_mask(mask, area, seen)
    points = camera.back_project_image(depth.metres)
    try:
        if table is not None:
            plane = table.moved(base_T_camera.inverse())
        else:
            plane = _find_table(points, seen, area if roi is not None else None, mask)
            table = plane.moved(base_T_camera)
        if mask is None:
            mask = _segment_standing_object(depth.metres, points, plane, area & seen)
    except InvalidInput as error:
        raise InvalidInput(error.detail, error.remedy + _hint_at_scale(depth)) from error
    return Scene(depth, camera, base_T_camera, mask, table)


def _hint_at_scale(depth: DepthImage) -> str:
    """A sentence that names the depth's unit as the probable cause; empty if distances are usual."""
    median = float(np.median(depth.metres[depth.metres > 0]))
    if USUAL_DEPTH[0] <= median <= USUAL_DEPTH[1]:
        return ""
    return f" The image is {median:.3g} m away in the median: check depth_scale, metres of one stored unit."


def _roi_to_mask(depth: DepthImage, roi: tuple[int, int, int, int] | None) -> Pixels:
    area = np.ones(depth.metres.shape, dtype=bool)
    if roi is None:
        return area
    u0, v0, u1, v1 = roi
    if not (0 <= u0 < u1 and 0 <= v0 < v1):
        raise InvalidInput(
            f"roi {list(roi)} holds no pixel.", "Give [u0, v0, u1, v1] with 0 <= u0 < u1 and 0 <= v0 < v1."
        )
    if u0 >= depth.width or v0 >= depth.height:
        raise InvalidInput(
            f"roi {list(roi)} lies outside the image of {depth.width} x {depth.height} pixels.",
            "Send [u0, v0, u1, v1] in the depth image's pixels.",
        )
    area[:] = False
    area[v0:v1, u0:u1] = True
    return area


def _validate_mask(mask: Pixels, area: Pixels, seen: Pixels) -> Pixels:
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
        raise InvalidInput(
            "The depth image has no data within the mask.", "Check that the mask belongs to the depth image."
        )
    return mask & area


def _find_table(points: Array, seen: Pixels, area: Pixels | None, mask: Pixels | None) -> Plane:
    """The table in the camera frame, fitted to the object's surroundings or, failing that, to the whole image."""
    stages = [(seen, 0.0)]
    if mask is not None:
        beside = seen & ~ndimage.binary_dilation(mask, iterations=3)
        stages = [(beside & _pad_bounding_box(mask, 1.0), 0.5), (beside, 0.0)]
    elif area is not None:
        stages = [(seen & _pad_bounding_box(area, 0.5), 0.5), (seen, 0.0)]
    for pixels, below_weight in stages:
        plane = fit_table(points[pixels], below_weight)
        if plane is not None and (mask is None or np.median(plane.height(points[mask & seen])) > 0):
            return plane
    if mask is not None and (share := float(mask[seen].mean())) > _MAX_MASK_SHARE:
        raise InvalidInput(
            f"No table was found: the mask covers {share:.0%} of the depth image.", "Mark the object's pixels alone."
        )
    raise InvalidInput(
        "No table was found in the depth image.",
        "Give the table, by its unit normal and offset, or a view with more of the table.",
    )


def _pad_bounding_box(area: Pixels, share: float) -> Pixels:
    """The bounding box of `area`, padded on each side by `share` of its size and at least 20 pixels."""
    v, u = np.nonzero(area)
    pad_v, pad_u = (max(20, int(share * (np.ptp(x) + 1))) for x in (v, u))
    grown = np.zeros_like(area)
    grown[max(0, v.min() - pad_v) : v.max() + pad_v + 1, max(0, u.min() - pad_u) : u.max() + pad_u + 1] = True
    return grown


def _segment_standing_object(depth: NDArray[np.float32], points: Array, table: Plane, area: Pixels) -> Pixels:
    """The largest cluster of pixels in `area` that stands on the table (camera frame)."""
    heights = table.height(points)
    std = height_std(points, table.normal)
    flat = np.where(depth > 0, np.clip(heights, -0.02, 0.02), 0.0)
    mean = ndimage.uniform_filter(flat, 3) / np.maximum(ndimage.uniform_filter((depth > 0).astype(np.float64), 3), 0.1)
    above = area & (mean > np.maximum(_MIN_PIXEL_HEIGHT, 2 * std)) & (heights > std)
    labels = label_clusters(depth, remove_flying_pixels(depth, above))
    table_T_camera = table.frame().inverse()
    outline = _fit_outline(table_T_camera.apply(points)[..., :2], (depth > 0) & (np.abs(heights) < 3 * std + 0.002))
    pixels: Pixels
    for label in range(1, min(int(labels.max()), _MAX_CLUSTERS) + 1):
        pixels = labels == label
        if pixels.sum() < MIN_OBJECT_PIXELS:
            break
        foot, top = heights[pixels].min(), np.percentile(heights[pixels], 95)
        over = table_T_camera.apply(points[pixels])[:, :2] @ outline[:, :2].T + outline[:, 2] <= -_OUTLINE_MARGIN
        if foot < _MAX_FOOT and top > _MIN_HEIGHT and over.all(axis=1).mean() >= 0.5:
            return pixels
    raise InvalidInput(
        "Nothing stands on the table within the view, or within the roi if one was sent.",
        "Give a mask or another roi, and check that the table's normal points towards the camera.",
    )


def _fit_outline(places: Array, table: Pixels) -> Array:
    """The convex hull of the table's large components: half planes (m, 3) with a x + b y + c <= 0 inside.

    Args:
        places: (h, w, 2), m, each pixel's (x, y) in the table's frame.
        table: (h, w), pixels at the table's height: the table, and stray ones where its plane cuts other things.
    """
    pieces, _ = ndimage.label(table, structure=np.ones((3, 3)))
    sizes = np.bincount(pieces.ravel())
    sizes[0] = 0
    large = np.isin(pieces, np.flatnonzero(sizes >= max(MIN_OBJECT_PIXELS, 0.1 * sizes.max())))
    try:
        return np.asarray(ConvexHull(places[large]).equations, dtype=np.float64)
    except (QhullError, ValueError):
        return np.zeros((0, 3))
