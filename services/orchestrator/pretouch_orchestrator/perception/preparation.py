"""Prepares what a client saw for a session: the object's surroundings, cleaned, and what is odd about the input."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pretouch.camera import DepthImage
from pretouch.prior import Prior
from pretouch.scene import Scene
from pretouch.session import SessionRequest
from pretouch.session_warning import SessionWarning
from pretouch_orchestrator.perception.clusters import find_specks
from pretouch_orchestrator.perception.depth_check import check_intrinsics
from pretouch_orchestrator.perception.placement_check import check_placement
from pretouch_orchestrator.perception.segmentation import find_object
from pretouch_orchestrator.perception.tolerance_check import check_points

_CROP_MARGIN = 0.14
"""m around the object that the crop keeps, besides three standard deviations of the prior."""
_MAX_PIXELS, _MAX_OBJECT_PIXELS = 1_000_000, 100_000
"""Pixels that a session keeps of an image, and of the object: of more, every second one in each direction, or every
third, and so on. The registrar registers no more of an object in any case."""
_BYTES_A_PIXEL, _BYTES_OF_AN_IMAGE = 240, 8
"""Memory for perception in a pixel that is kept, and in one that is sent: half as much again as was measured."""


def prepare_scene(
    request: SessionRequest, depth: DepthImage, mask: NDArray[np.bool_] | None
) -> tuple[Scene, tuple[int, int], tuple[SessionWarning, ...]]:
    """The client's view cropped to the object's surroundings, without specks.

    An image of more than a megapixel is subsampled first, and a large object once more.

    Returns:
        The view, the crop's first pixel (u0, v0), and what is legal but odd about what the client sent.

    Raises:
        InvalidInput: no depth, no object, no table, a mask or roi that does not fit, or what cannot be.
    """
    warnings = check_intrinsics(request, depth.width, depth.height)
    step = _choose_step(depth.metres.size / _MAX_PIXELS)
    camera, roi = request.camera, request.roi
    if step > 1 and (mask is None or mask.shape == depth.metres.shape):
        depth, camera = DepthImage(depth.metres[::step, ::step], depth.scale), camera.subsampled(step)
        mask = None if mask is None else mask[::step, ::step]
        roi = None if roi is None else (roi[0] // step, roi[1] // step, -(-roi[2] // step), -(-roi[3] // step))
    found = find_object(depth, camera, request.base_T_camera, roi, mask, request.table)
    whole = found.scene
    warnings += [*found.warnings, *check_placement(request, whole, found.seen), *check_points(request, whole)]
    prior = (request.prior or Prior()).fallback
    scene, origin = whole.cropped(
        _CROP_MARGIN + 3 * float(np.hypot(prior.translation_std, prior.rotation_std * whole.radius))
    )
    metres = scene.depth.metres
    cleaned = np.where(find_specks(metres, scene.camera.fx) & ~scene.mask, 0, metres)
    scene = replace(scene, depth=DepthImage(cleaned))
    coarser = _choose_step(scene.mask.sum() / _MAX_OBJECT_PIXELS)
    return scene.subsampled(coarser), (step * origin[0], step * origin[1]), tuple(warnings)


def _choose_step(ratio: float) -> int:
    """The step that leaves one pixel of `ratio` pixels, or fewer."""
    return max(1, int(np.ceil(np.sqrt(ratio))))


def estimate_preparation(pixels: int) -> int:
    """Bytes that `prepare_scene` needs at its peak for an image of so many pixels."""
    return _BYTES_A_PIXEL * min(pixels, _MAX_PIXELS) + _BYTES_OF_AN_IMAGE * pixels
