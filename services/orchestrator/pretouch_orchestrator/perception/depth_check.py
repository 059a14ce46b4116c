"""Whether a depth image and its intrinsics can be what the client says: unit, order of bytes, resolution."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pretouch.camera import Camera, DepthImage
from pretouch.errors import InvalidInput
from pretouch.geometry import Array
from pretouch.scene import Scene
from pretouch.session import SessionRequest
from pretouch.session_warning import SessionWarning

USUAL_DEPTH = (0.2, 5.0)
"""m: a median depth outside is most often in a wrong unit."""
_POSSIBLE_DEPTH = (0.1, 10.0)
"""m: no depth camera measures nearer, and no finger scans what is farther."""
_SCALES = (1.0, 0.01, 0.001, 0.0001, 0.0002, 0.00025)
"""m of one stored unit of known cameras and file formats."""
_LIKELY_DEPTH = (0.3, 2.0)
"""m: where most tables are that a robot reaches."""
_MAX_OBJECT = 2.0
"""m: longest object on a table."""
_MIN_ROUGHNESS, _MIN_GAIN = 0.05, 10.0
"""Median difference of neighbouring pixels, as a share of the depth, that no camera sees; and by what factor it falls
where swapping the bytes mends it."""
_MAX_OFF_CENTRE = 0.1
"""Share of the image's side that a principal point may be from the middle: cameras have 5 %, cropped images more."""
_MAX_ASPECT = 1.25
"""Ratio of the focal lengths: pixels are nearly square."""
_FIELD = (np.radians(10.0), np.radians(130.0))
"""rad: fields of view of depth cameras, along the image's longer side."""
_SIZES = (0.25, 1 / 3, 0.5, 2 / 3, 0.75, 4 / 3, 1.5, 2.0, 3.0, 4.0)
"""Ratios of the resolutions that one camera offers."""


def describe_depth(depth: DepthImage) -> str:
    """The median depth of an image with depth and the scale that was used, and the scales that would be likelier."""
    median = float(np.median(depth.metres[depth.metres > 0]))
    text = f"The median depth is {median:.3g} m with depth_scale {depth.scale:g}."
    if USUAL_DEPTH[0] <= median <= USUAL_DEPTH[1]:
        return text
    return f"{text}{suggest_scales(depth, median)}"


def suggest_scales(depth: DepthImage, distance: float) -> str:
    """The scales by which a `distance`, m, would be likely: a sentence, or nothing."""
    likely = {scale: distance * scale / depth.scale for scale in _SCALES if scale != depth.scale}
    likely = {scale: z for scale, z in likely.items() if _LIKELY_DEPTH[0] <= z <= _LIKELY_DEPTH[1]}
    if not likely:
        return ""
    return f" It would be {' or '.join(f'{z:.2f} m with {scale:g}' for scale, z in likely.items())}."


def check_depth(depth: DepthImage) -> None:
    """Raises `InvalidInput` if the image has no depth, its bytes are swapped, or nothing in it can be scanned."""
    seen = depth.metres > 0
    if not seen.any():
        raise InvalidInput(
            f"The depth image holds no depth: all of it is no data, with depth_scale {depth.scale:g}.",
            "Send metres = value x camera.depth_scale; 0 means no data, as NaN and a type's largest value do.",
        )
    _check_bytes(depth)
    near, far = _POSSIBLE_DEPTH
    if not (seen & (depth.metres >= near) & (depth.metres <= far)).any():
        raise InvalidInput(
            f"No pixel of the depth image is {near:g} to {far:g} m away. {describe_depth(depth)}",
            "Send camera.depth_scale, the metres of one stored unit.",
        )


def _check_bytes(depth: DepthImage) -> None:
    """Swapping the bytes of 16-bit values, if the image is far too rough, must not make it smooth."""
    rough = _measure_roughness(depth.metres)
    if rough < _MIN_ROUGHNESS:
        return
    stored = np.round(depth.metres / depth.scale)
    if stored.max() > np.iinfo(np.uint16).max:
        return
    if _measure_roughness(stored.astype(np.uint16).byteswap().astype(np.float64)) * _MIN_GAIN > rough:
        return
    raise InvalidInput(
        f"The bytes of the depth image look swapped: neighbouring pixels differ by {rough:.0%} in the median, and "
        f"swapped by less than a tenth of that. {describe_depth(depth)}",
        "Send little-endian values in .npy files and messages; PNG files are big-endian, as libraries write them.",
    )


def _measure_roughness(depth: NDArray[np.floating[Any]]) -> float:
    """The median difference of neighbours with depth, as a share of the depth, along rows or columns: the larger.

    Images may well be constant along either: of a table, along the horizon.
    """
    thin = max(1, max(depth.shape) // 100)
    rows, columns = depth[::thin], depth[:, ::thin]
    roughness = [0.0]
    for a, b in ((rows[:, :-1], rows[:, 1:]), (columns[:-1], columns[1:])):
        both = (a > 0) & (b > 0)
        if both.any():
            roughness.append(float(np.median(np.abs(a[both] - b[both]) / np.minimum(a[both], b[both]))))
    return max(roughness)


def check_object(scene: Scene) -> None:
    """Raises `InvalidInput` if no camera and no robot could see and scan the object where it is said to be."""
    near, far = _POSSIBLE_DEPTH
    depths = scene.depth.metres[scene.mask]
    middle = float(np.median(depths))
    said = f"{middle:.3g} m from the camera, in the median, with depth_scale {scene.depth.scale:g}."
    if not ((depths >= near) & (depths <= far)).any():
        raise InvalidInput(
            f"The object is {said}{suggest_scales(scene.depth, middle)}",
            f"Send camera.depth_scale, the metres of one stored unit: objects are {near:g} to {far:g} m away.",
        )
    size = measure_size(scene.cloud)
    if size > _MAX_OBJECT:
        raise InvalidInput(
            f"The object is {size:.3g} m long, and {said}{suggest_scales(scene.depth, middle)}",
            f"Check camera.depth_scale, the focal lengths and the mask: objects are at most {_MAX_OBJECT:g} m long.",
        )


def measure_size(cloud: Array) -> float:
    """m: the longest side of the box about points (n, 3) without their outermost hundredth on each side."""
    return float(np.ptp(np.quantile(cloud, (0.01, 0.99), axis=0), axis=0).max())


def check_intrinsics(request: SessionRequest, width: int, height: int) -> list[SessionWarning]:
    """What is odd about the intrinsics for an image of `width` x `height` pixels.

    Raises:
        InvalidInput: the principal point lies outside the image.
    """
    camera = request.camera
    if not (0 <= camera.cx <= width - 1 and 0 <= camera.cy <= height - 1):
        raise InvalidInput(
            f"The principal point ({camera.cx:g}, {camera.cy:g}) lies outside the image of {width} x {height} pixels."
            f"{_explain_centre(camera, width, height)}",
            "Send the intrinsics of this image in its pixels; send the whole image with a roi rather than a crop.",
        )
    warnings = []
    if (given := (request.width or width, request.height or height)) != (width, height):
        warnings.append(
            SessionWarning(
                "intrinsics-resolution",
                f"The intrinsics are said to be for {given[0]} x {given[1]} pixels; the image has {width} x {height}.",
                f"Multiply fx, cx by {width / given[0]:.4g} and fy, cy by {height / given[1]:.4g} if the image was "
                "scaled, or send the intrinsics of this image.",
            )
        )
    off = max(abs(camera.cx - (width - 1) / 2) / width, abs(camera.cy - (height - 1) / 2) / height)
    if off > _MAX_OFF_CENTRE:
        warnings.append(
            SessionWarning(
                "principal-point",
                f"The principal point ({camera.cx:g}, {camera.cy:g}) is far from the middle of the image, "
                f"({(width - 1) / 2:g}, {(height - 1) / 2:g}).{_explain_centre(camera, width, height)}",
                "Send the intrinsics of this image, at its resolution. If the image is a crop, this is right.",
            )
        )
    field = 2 * np.arctan(max(width / camera.fx, height / camera.fy) / 2)
    if not (_FIELD[0] <= field <= _FIELD[1] and 1 / _MAX_ASPECT <= camera.fx / camera.fy <= _MAX_ASPECT):
        warnings.append(
            SessionWarning(
                "focal-length",
                f"The focal lengths {camera.fx:g} and {camera.fy:g} pixels give a field of view of "
                f"{np.degrees(2 * np.arctan(width / camera.fx / 2)):.0f} x "
                f"{np.degrees(2 * np.arctan(height / camera.fy / 2)):.0f} degrees.",
                "Send fx and fy in pixels of this image, not in millimetres.",
            )
        )
    return warnings


def _explain_centre(camera: Camera, width: int, height: int) -> str:
    """The mistake that puts the principal point in the middle when it is mended: a sentence, or nothing."""
    if _is_central(camera.cy, camera.cx, width, height):
        return " cx and cy look swapped."
    for size in _SIZES:
        if _is_central((camera.cx + 0.5) * size - 0.5, (camera.cy + 0.5) * size - 0.5, width, height):
            other = f"{width / size:.0f} x {height / size:.0f}"
            return f" The intrinsics look like those of {other} pixels: multiply all four by {size:.4g}."
    return ""


def _is_central(cx: float, cy: float, width: int, height: int) -> bool:
    usual = _MAX_OFF_CENTRE / 2
    return abs(cx - (width - 1) / 2) <= usual * width and abs(cy - (height - 1) / 2) <= usual * height
