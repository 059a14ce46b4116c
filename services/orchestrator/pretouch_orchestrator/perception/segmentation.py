"""Segments object and table in the depth image, unless the client gives a mask or the table."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from pretouch.camera import Camera, DepthImage
from pretouch.errors import InvalidInput
from pretouch.geometry import Array, Plane, Pose
from pretouch.scene import MIN_OBJECT_PIXELS, Scene
from pretouch.session_warning import SessionWarning
from pretouch_orchestrator.perception.depth_check import check_depth, check_object, describe_depth
from pretouch_orchestrator.perception.object_mask import check_mask, clean_mask, is_large, refuse_inverted
from pretouch_orchestrator.perception.table import fit_table
from pretouch_orchestrator.perception.table_view import Pixels, TableView

_MIN_HEIGHT = 0.008
"""m: least height of an object above the table."""
_MAX_FOOT = 0.03
"""m: the lowest seen point of an object that stands on the table is at most this high."""
_MAX_CLUSTERS = 20
_MAX_MASK_SHARE = 0.6
"""Share of the depth above which a mask holds more than an object."""
_AGREEING, _MIN_AGREEING = 0.05, 0.3
"""m from the given table, and share of what is seen around the object that lies within it: then the image shows it."""
_MAX_SUNK = 0.002
"""m below a plane beyond which the middle of a mask shows that the plane is not what the object stands on."""


class Found(NamedTuple):
    """An object in a view.

    Attributes:
        scene: the object and its table, the one given if one was.
        seen: the table that the image shows, in the camera frame; None: it shows none.
        warnings: what is odd about the mask that marks the object.
    """

    scene: Scene
    seen: Plane | None
    warnings: tuple[SessionWarning, ...] = ()


def find_object(
    depth: DepthImage,
    camera: Camera,
    base_T_camera: Pose,
    roi: tuple[int, int, int, int] | None = None,
    mask: Pixels | None = None,
    table: Plane | None = None,
) -> Found:
    """Segments the client's view.

    Args:
        depth: (h, w).
        base_T_camera: extrinsics as the client believes them.
        roi: (u0, v0, u1, v1), half-open: the object is within it; a mask is intersected with it.
        mask: (h, w), True on the object, which is cleaned; None: the largest object that stands on the table within
            the roi is taken.
        table: in base by `base_T_camera`; None: the plane with the most support around the object is taken.

    Raises:
        InvalidInput: no depth, a roi outside the image, a mask of another size, without depth or of no object, no
            table, no object, or one where no object can be.
    """
    check_depth(depth)
    seen = depth.metres > 0
    area = _roi_to_mask(depth, roi)
    if mask is not None:
        mask = check_mask(mask, area, depth)
    points = camera.back_project_image(depth.metres)
    warnings: tuple[SessionWarning, ...] = ()
    shown: Plane | None
    try:
        if table is None:
            shown = plane = _find_table(depth, points, area if roi is not None else None, mask)
            table = plane.moved(base_T_camera)
            view = TableView(depth.metres, points, plane)
        else:
            view = TableView(depth.metres, points, table.moved(base_T_camera.inverse()))
            shown = _find_shown_table(view, mask)
            _check_given_table(view, shown)
        if mask is None:
            pixels = _segment_standing_object(view, area & seen)
        else:
            if is_large(mask, seen):
                refuse_inverted(view, mask)
            pixels, warnings = clean_mask(view, mask)
        scene = Scene(depth, camera, base_T_camera, pixels, table)
    except InvalidInput as error:
        raise InvalidInput(f"{error.detail} {describe_depth(depth)}", error.remedy) from error
    check_object(scene)
    return Found(scene, shown, warnings)


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


def _find_table(depth: DepthImage, points: Array, area: Pixels | None, mask: Pixels | None) -> Plane:
    """The table in the camera frame, fitted to the object's surroundings or, failing that, to the whole image."""
    seen = depth.metres > 0
    if mask is not None and is_large(mask, seen) and (whole := fit_table(points[seen], 0.0)) is not None:
        refuse_inverted(TableView(depth.metres, points, whole), mask)
    stages = [(seen, 0.0)]
    if mask is not None:
        beside = seen & ~ndimage.binary_dilation(mask, iterations=3)
        stages = [(beside & _pad_bounding_box(mask, 1.0), 0.5), (beside, 0.0)]
    elif area is not None:
        stages = [(seen & _pad_bounding_box(area, 0.5), 0.5), (seen, 0.0)]
    for pixels, below_weight in stages:
        plane = fit_table(points[pixels], below_weight)
        if plane is not None and (mask is None or np.median(plane.height(points[mask & seen])) > -_MAX_SUNK):
            return plane
    if mask is not None and (share := float(mask[seen].mean())) > _MAX_MASK_SHARE:
        raise InvalidInput(
            f"No table was found: the mask covers {share:.0%} of the depth image.", "Mark the object's pixels alone."
        )
    raise InvalidInput(
        "No table was found in the depth image.",
        "Give the table, by its unit normal and offset, or a view with more of the table.",
    )


def _find_shown_table(view: TableView, mask: Pixels | None) -> Plane | None:
    """The table that the image shows, in the camera frame: the given one where enough of it is seen."""
    beside = view.depth > 0
    if mask is not None:
        beside &= _pad_bounding_box(mask, 1.0) & ~ndimage.binary_dilation(mask, iterations=3)
    if beside.any() and (np.abs(view.heights[beside]) < _AGREEING).mean() >= _MIN_AGREEING:
        return view.table
    return fit_table(view.points[beside], 0.5 if mask is not None else 0.0)


def _check_given_table(view: TableView, shown: Plane | None) -> None:
    """Raises `InvalidInput` if the camera looks at the table from below."""
    if view.table.offset <= 0:
        return
    known = "" if shown is None else f" The table that the image shows is {-shown.offset:.2f} m from the camera."
    raise InvalidInput(
        f"The camera is {view.table.offset:.2f} m below the table that was given.{known}",
        "Give the table's unit normal, away from the table, and its offset, both in base; check base_T_camera; or "
        "leave table out.",
    )


def _pad_bounding_box(area: Pixels, share: float) -> Pixels:
    """The bounding box of `area`, padded on each side by `share` of its size and at least 20 pixels."""
    v, u = np.nonzero(area)
    pad_v, pad_u = (max(20, int(share * (np.ptp(x) + 1))) for x in (v, u))
    grown = np.zeros_like(area)
    grown[max(0, v.min() - pad_v) : v.max() + pad_v + 1, max(0, u.min() - pad_u) : u.max() + pad_u + 1] = True
    return grown


def _segment_standing_object(view: TableView, area: Pixels) -> Pixels:
    """The largest cluster of pixels in `area` (h, w) that stands on the table."""
    labels = view.label(area & view.raised)
    for label in range(1, min(int(labels.max()), _MAX_CLUSTERS) + 1):
        pixels: Pixels = labels == label
        if pixels.sum() < MIN_OBJECT_PIXELS:
            break
        foot, top = view.heights[pixels].min(), np.percentile(view.heights[pixels], 95)
        if foot < _MAX_FOOT and top > _MIN_HEIGHT and view.is_over_table(view.points[pixels]):
            return pixels
    raise InvalidInput(
        "Nothing stands on the table within the view, or within the roi if one was sent.",
        "Give a mask or another roi, and check that the table's normal points towards the camera.",
    )
