"""The pinhole camera and its depth image.

Camera frame: x right, y down, z forward; pixel centres at integers; no distortion. Depth is z along the optical axis.
"""

from __future__ import annotations

import io
import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from pretouch.errors import InvalidInput, Malformed, TooLarge
from pretouch.geometry import Array, frozen_array

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
MAX_PIXELS = 4_000_000
MAX_DEPTH = 10_000.0
"""m; more is a wrong scale."""
DEFAULT_DEPTH_SCALE = {np.dtype(np.uint16): 0.001, np.dtype(np.float32): 1.0}
"""m of one stored unit of each type of depth image, where nothing is said about it."""
_MAX_PNG_CHUNKS = 10_000  # libpng writes an image of MAX_PIXELS in about a thousand
_SHORTEST_FOCAL_LENGTH, _LARGEST_INTRINSIC = 0.01, 1e6  # pixels


@dataclass(frozen=True)
class Camera:
    """Pinhole intrinsics; pixel centres are at integers, there is no distortion.

    Attributes:
        fx: focal length along u, in pixels.
        fy: focal length along v, in pixels.
        cx: principal point along u, in pixels.
        cy: principal point along v, in pixels.

    Raises:
        Malformed: a value is not finite.
        InvalidInput: a focal length is not positive, or a value beyond any camera.
    """

    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        for name in ("fx", "fy", "cx", "cy"):
            object.__setattr__(
                self, name, float(frozen_array(getattr(self, name), (), f"camera.{name}", _LARGEST_INTRINSIC))
            )
        if min(self.fx, self.fy) < _SHORTEST_FOCAL_LENGTH:
            raise InvalidInput(
                f"The focal lengths are {self.fx:g} and {self.fy:g} pixels.", "Send camera.fx and camera.fy in pixels."
            )

    def project(self, points: ArrayLike) -> Array:
        """Points (..., 3) in the camera frame, z > 0, to pixels (..., 2) as (u, v)."""
        p = np.asarray(points, dtype=np.float64)
        return np.stack([self.fx * p[..., 0] / p[..., 2] + self.cx, self.fy * p[..., 1] / p[..., 2] + self.cy], axis=-1)

    def back_project(self, pixels: ArrayLike, depth: ArrayLike) -> Array:
        """Pixels (..., 2) as (u, v) with depths (...,), m, to points (..., 3) in the camera frame."""
        uv, z = np.asarray(pixels, dtype=np.float64), np.asarray(depth, dtype=np.float64)
        return np.stack([(uv[..., 0] - self.cx) * z / self.fx, (uv[..., 1] - self.cy) * z / self.fy, z], axis=-1)

    def back_project_image(self, depth: ArrayLike) -> Array:
        """A depth image (h, w), m, to points (h, w, 3) in the camera frame; (0, 0, 0) where there is no data."""
        z = np.asarray(depth, dtype=np.float64)
        v, u = np.indices(z.shape)
        return self.back_project(np.stack([u, v], axis=-1), z)

    def cropped(self, u0: int, v0: int) -> Camera:
        """The camera of an image whose first pixel was (u0, v0)."""
        return Camera(self.fx, self.fy, self.cx - u0, self.cy - v0)

    def subsampled(self, step: int) -> Camera:
        """The camera of an image of every `step`-th pixel in each direction, the first one kept."""
        return Camera(self.fx / step, self.fy / step, self.cx / step, self.cy / step)


@dataclass(frozen=True, eq=False)
class DepthImage:
    """A depth image.

    Attributes:
        metres: (h, w) float32, z along the optical axis; 0 where there is no data. NaN, infinite and negative values
            given become 0.
        scale: m of one stored unit of the image that was sent, for what is said about it; 1 for metres.
    """

    metres: NDArray[np.float32]
    scale: float = 1.0

    def __post_init__(self) -> None:
        values = np.asarray(self.metres)
        if values.ndim != 2 or values.size == 0:
            raise InvalidInput(
                f"The depth image has shape {list(values.shape)}.", "Send a depth image of h x w values."
            )
        if values.size > MAX_PIXELS:
            raise TooLarge(
                f"The depth image has {values.size} pixels; the limit is {MAX_PIXELS}.",
                "Send a smaller or cropped image.",
            )
        metres = values.astype(np.float32)
        metres[~(np.isfinite(metres) & (metres > 0))] = 0.0
        if metres.max() > MAX_DEPTH:
            raise InvalidInput(
                f"The depth image holds {metres.max():g} m; the limit is {MAX_DEPTH:g} m. Its median is "
                f"{np.median(metres[metres > 0]):.3g} m with depth_scale {self.scale:g}.",
                "Check camera.depth_scale and the order of bytes, and send 0 or NaN where there is no data.",
            )
        metres.setflags(write=False)
        object.__setattr__(self, "metres", metres)

    @staticmethod
    def from_values(values: NDArray[np.generic], depth_scale: float | None = None) -> DepthImage:
        """From stored values (h, w), uint16 or float32; metres = value x depth_scale.

        The largest value of the type means no data, as 0 does.

        Args:
            depth_scale: m; None: DEFAULT_DEPTH_SCALE.

        Raises:
            InvalidInput: another type, or a scale that is not positive.
        """
        if values.dtype not in DEFAULT_DEPTH_SCALE:
            raise InvalidInput(
                f"The depth image holds {values.dtype} values.", "Send uint16 or float32 values and camera.depth_scale."
            )
        if depth_scale is None:
            depth_scale = DEFAULT_DEPTH_SCALE[values.dtype]
        scale = float(frozen_array(depth_scale, (), "camera.depth_scale"))
        if scale <= 0:
            raise InvalidInput(f"camera.depth_scale is {scale:g}.", "Send the metres that one stored unit stands for.")
        largest = np.iinfo(np.uint16).max if values.dtype == np.uint16 else np.finfo(np.float32).max
        with np.errstate(over="ignore", invalid="ignore"):
            metres = (values.astype(np.float64) * scale).astype(np.float32)
        return DepthImage(np.where(values == largest, np.float32(0), metres), scale)

    @property
    def height(self) -> int:
        return int(self.metres.shape[0])

    @property
    def width(self) -> int:
        return int(self.metres.shape[1])


def kinect_depth_std(z: ArrayLike) -> Array:
    """m: standard deviation of a Kinect's depth at depths `z`, m, quantisation included.

    After Nguyen, Izadi, Lovell, "Modeling Kinect Sensor Noise for Improved 3D Reconstruction and Tracking", 3DIMPVT
    2012.
    """
    return np.asarray(0.0012 + 0.0019 * (np.asarray(z, dtype=np.float64) - 0.4) ** 2, dtype=np.float64)


def count_pixels(data: bytes) -> int:
    """How many pixels a PNG says that it has, at most MAX_PIXELS; 0 for anything else."""
    if not (data.startswith(_PNG_SIGNATURE) and len(data) >= 24):
        return 0
    width, height = struct.unpack(">II", data[16:24])
    return min(int(width * height), MAX_PIXELS)


def decode_depth(data: bytes) -> NDArray[np.generic]:
    """Stored values (h, w) of a 16-bit PNG, or of an `.npy` file of uint16 or float32 (never unpickled).

    Raises:
        Malformed: neither, or damaged.
        TooLarge: more than MAX_PIXELS pixels.
        InvalidInput: a PNG that is not 16-bit grey, an array of another type or shape.
    """
    if data.startswith(b"\x93NUMPY"):
        return _decode_npy(data)
    image = decode_png(data, "depth image")
    if image.dtype not in (np.uint16, np.int32):
        raise InvalidInput(
            "The depth PNG is not 16-bit greyscale.", "Send a 16-bit greyscale PNG, or an .npy of uint16 or float32."
        )
    return image.astype(np.uint16)


def _decode_npy(data: bytes) -> NDArray[np.generic]:
    stream = io.BytesIO(data)
    remedy = "Write it with numpy.save from a two-dimensional uint16 or float32 array."
    try:
        version = np.lib.format.read_magic(stream)
        if version not in ((1, 0), (2, 0), (3, 0)):
            raise ValueError(version)
        read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran_order, dtype = read_header(stream)
    except Exception as error:  # numpy raises many kinds on a damaged header
        raise Malformed("The .npy depth image has a damaged header.", remedy) from error
    if len(shape) != 2 or dtype.newbyteorder("=") not in (np.dtype(np.uint16), np.dtype(np.float32)):
        raise InvalidInput(f"The .npy depth image holds {dtype} values of shape {list(shape)}.", remedy)
    if any(type(side) is not int or side < 1 for side in shape):  # True is a number to numpy's header, and to no array
        raise InvalidInput(f"The .npy depth image has shape {list(shape)!s:.80}.", remedy)
    count = shape[0] * shape[1]
    if count > MAX_PIXELS:
        raise TooLarge(f"The depth image has {count:g} pixels; the limit is {MAX_PIXELS}.", "Crop it.")
    if len(data) - stream.tell() < count * dtype.itemsize:
        raise Malformed("The .npy depth image is cut short.", remedy)
    values = np.frombuffer(data, dtype, count, stream.tell()).reshape(shape, order="F" if fortran_order else "C")
    return np.ascontiguousarray(values, dtype.newbyteorder("="))


def decode_png(data: bytes, name: str) -> NDArray[np.generic]:
    """Values (h, w) of a single-channel PNG, or (h, w, c) of a coloured one.

    Raises:
        Malformed: not a PNG, or damaged.
        TooLarge: more than MAX_PIXELS pixels.
    """
    pixels = _count_png_pixels(data)
    if pixels > MAX_PIXELS:
        raise TooLarge(f"The {name} has {pixels} pixels; the limit is {MAX_PIXELS}.", "Crop it.")
    try:
        if pixels == 0:
            raise ValueError("no PNG, or one whose header does not come first and once")
        with Image.open(io.BytesIO(data), formats=("PNG",)) as image:
            return np.array(image)
    except Exception as error:  # Pillow raises many kinds on damaged files
        raise Malformed(f"The {name} is not a readable PNG.", f"Send the {name} as a PNG file.") from error


def _count_png_pixels(data: bytes) -> int:
    """Pixels by a PNG's header, so that nothing larger is unpacked; 0 for what is no PNG.

    Pillow believes the last header, wherever it is, and takes long over very many chunks.
    """
    at, pixels = len(_PNG_SIGNATURE), 0
    if not data.startswith(_PNG_SIGNATURE):
        return 0
    for number in range(_MAX_PNG_CHUNKS):
        if len(data) < at + 8:
            return pixels
        length, kind = struct.unpack_from(">I4s", data, at)
        if (kind == b"IHDR") != (number == 0):
            return 0
        if number == 0:
            if len(data) < at + 16:
                return 0
            width, height = struct.unpack_from(">II", data, at + 8)
            pixels = width * height
        if kind == b"IEND":
            return pixels
        at += 12 + length
    return 0
