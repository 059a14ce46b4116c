"""What a file of points holds, and the errors that all readers share."""

from __future__ import annotations

import io
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pretouch.errors import InvalidInput, Malformed, NotFound
from pretouch.geometry import MAX_DISTANCE, Array

MAX_POINTS = 50_000_000


@dataclass(frozen=True, eq=False)
class Shape:
    """Points, and triangles between them if there are any.

    Attributes:
        points: (n, 3), finite, n at least 1; unit and frame are the file's.
        faces: (m, 3) indices into `points`; None in a file of points alone.
        viewpoint: (3,) where the sensor was, in the points' frame; None if the file does not say.
        left_out: points of the file that were NaN, "no data" by custom.
    """

    points: Array
    faces: NDArray[np.int64] | None = None
    viewpoint: Array | None = None
    left_out: int = 0


def checked_shape(
    name: str, points: NDArray[Any], faces: NDArray[np.int64] | None = None, viewpoint: Array | None = None
) -> Shape:
    """A shape from the numbers (n, 3) that the file `name` holds.

    Raises:
        Malformed: an infinite number.
        InvalidInput: no point left, or one farther away than any robot reaches.
    """
    values = np.asarray(points, dtype=np.float64)
    if np.isinf(values).any():
        raise Malformed(f"{name} holds infinite coordinates.", "Leave such points out, or write NaN for no data.")
    good = ~np.isnan(values).any(axis=1)
    if not good.any():
        raise InvalidInput(f"{name} holds no point with coordinates.", "Check what was exported.")
    if np.abs(values[good]).max() > MAX_DISTANCE:
        raise InvalidInput(f"{name} holds coordinates beyond {MAX_DISTANCE:g} m.", "Write metres.")
    if faces is not None:
        return Shape(values, faces, viewpoint)  # NaN is refused by the mesh
    return Shape(np.ascontiguousarray(values[good]), None, viewpoint, int((~good).sum()))


def read_bytes(path: Path) -> bytes:
    """The file's bytes.

    Raises:
        NotFound: there is no such file, or it cannot be read.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        raise NotFound(f"{path} cannot be read: {error.strerror}.", "Check the path.") from error


def checked_count(name: str, count: int) -> int:
    """`count` of points or faces if a file may announce as many.

    Raises:
        InvalidInput: less than none, or more than MAX_POINTS.
    """
    if not 0 <= count <= MAX_POINTS:
        raise InvalidInput(f"{name} announces {count} points or faces; the limit is {MAX_POINTS}.", "Thin it out.")
    return count


def cut_short(name: str) -> Malformed:
    return Malformed(f"{name} ends before all that its header announces.", "Write the file again.")


def read_columns(name: str, stream: io.BytesIO, count: int, columns: list[int]) -> Array:
    """The next `count` lines of numbers: these columns of them, (count, columns).

    Raises:
        Malformed: fewer lines, or one that does not hold numbers.
    """
    if count == 0:
        return np.zeros((0, len(columns)))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an empty body is said below
            values = np.loadtxt(stream, usecols=columns, max_rows=count, ndmin=2, comments=None)
    except ValueError as error:
        raise Malformed(f"{name} holds a line that is not a point.", "Write the file again.") from error
    if len(values) < count:
        raise cut_short(name)
    return np.asarray(values, dtype=np.float64)
