"""Converts the depth images and masks that a robot program has to files for REST and to arrays for gRPC."""

from __future__ import annotations

import io
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from pretouch.camera import decode_depth, decode_png
from pretouch.errors import InvalidInput
from pretouch.regular_file import read_regular_file

ImageLike = NDArray[Any] | bytes | str | PathLike[str]
"""An array (h, w), the bytes of a PNG or .npy file, or the path of one."""

_MAX_BYTES = 64 * 1024**2
"""Of a file: more than any image within the services' limits."""
_NPY = "application/x-npy"


def encode_depth(depth: ImageLike) -> tuple[bytes, str]:
    """A file's bytes and its media type: uint16 arrays become a 16-bit PNG, float32 arrays an .npy file."""
    if not isinstance(depth, np.ndarray):
        data = _read(depth)
        return data, _NPY if data.startswith(b"\x93NUMPY") else "image/png"
    values = _depth_array(depth)
    return (_png(values), "image/png") if values.dtype == np.uint16 else (_npy(values), _NPY)


def load_depth(depth: ImageLike) -> NDArray[np.generic]:
    """Stored values (h, w), uint16 or float32."""
    return _depth_array(depth) if isinstance(depth, np.ndarray) else decode_depth(_read(depth))


def encode_mask(mask: ImageLike) -> tuple[bytes, str]:
    """A PNG's bytes and media type, non-zero on the object."""
    return (_png(_mask_array(mask)) if isinstance(mask, np.ndarray) else _read(mask)), "image/png"


def load_mask(mask: ImageLike) -> NDArray[np.uint8]:
    """(h, w), 255 on the object, else 0."""
    return _mask_array(mask if isinstance(mask, np.ndarray) else decode_png(_read(mask), "mask"))


def _depth_array(depth: NDArray[Any]) -> NDArray[np.generic]:
    dtype = depth.dtype.newbyteorder("=")
    if depth.ndim != 2 or dtype not in (np.uint16, np.float32):
        raise InvalidInput(
            f"The depth image is an array of {depth.dtype} and shape {list(depth.shape)}.",
            "Give h x w values of uint16 or float32, such as depth.astype(numpy.float32), and the right depth_scale.",
        )
    return np.ascontiguousarray(depth, dtype=dtype)


def _mask_array(mask: NDArray[Any]) -> NDArray[np.uint8]:
    object_pixels = (mask != 0).any(axis=2) if mask.ndim == 3 else mask != 0
    if object_pixels.ndim != 2:
        raise InvalidInput(f"The mask has shape {list(mask.shape)}.", "Give h x w values, non-zero on the object.")
    return np.where(object_pixels, np.uint8(255), np.uint8(0))


def _read(image: bytes | str | PathLike[str]) -> bytes:
    if isinstance(image, bytes):
        return image
    return read_regular_file(Path(image), _MAX_BYTES)


def _png(values: NDArray[Any]) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(values).save(stream, "PNG", compress_level=1)
    return stream.getvalue()


def _npy(values: NDArray[Any]) -> bytes:
    stream = io.BytesIO()
    np.save(stream, values, allow_pickle=False)
    return stream.getvalue()
