"""What a file of points holds, and the checks that all readers share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pretouch.errors import InvalidInput, Malformed
from pretouch.geometry import MAX_DISTANCE, Array

MAX_POINTS = 50_000_000


@dataclass(frozen=True, eq=False)
class Shape:
    """Points, and triangles between them if there are any.

    Attributes:
        points: (n, 3), finite, n at least 1; unit and frame are the file's, metres where the file states its unit.
        faces: (m, 3) indices into `points`, m at least 1; None in a file of points alone.
        viewpoint: (3,) where the sensor was, in the points' frame; None if the file does not say.
        remarks: what was ignored or looks odd.
    """

    points: Array
    faces: NDArray[np.int64] | None = None
    viewpoint: Array | None = None
    remarks: tuple[str, ...] = ()


def make_shape(
    name: str,
    points: NDArray[Any],
    faces: NDArray[np.int64] | None = None,
    viewpoint: Array | None = None,
    remarks: tuple[str, ...] = (),
) -> Shape:
    """A shape from the numbers (n, 3) that the file `name` holds.

    Points that are NaN, "no data" by custom, are left out.

    Raises:
        Malformed: an infinite number, or a face with a corner that is NaN or does not exist.
        InvalidInput: no point left, or one farther away than any robot reaches.
    """
    values = np.asarray(points, dtype=np.float64)
    infinite = np.isinf(values).any(axis=1)
    if infinite.any():
        raise Malformed(
            f"{name} has infinite coordinates at vertex {int(np.argmax(infinite))}; the first is 0.",
            "Leave such points out, or write NaN for no data.",
        )
    good = np.asarray(np.isfinite(values).all(axis=1))
    if not good.any():
        raise InvalidInput(f"{name} holds no point with coordinates.", "Check what was exported.")
    if np.abs(values[good]).max() > MAX_DISTANCE:
        raise InvalidInput(f"{name} holds coordinates beyond {MAX_DISTANCE:g} m.", "Write metres.")
    if faces is not None and len(faces):
        _check_corners(name, faces, good)
    else:
        faces = None
    if not good.all():
        remarks = (*remarks, f"points without coordinates left out: {int((~good).sum())}.")
        if faces is not None:
            faces = (np.cumsum(good) - 1)[faces]
        values = values[good]
    return Shape(np.ascontiguousarray(values), faces, viewpoint, remarks)


def _check_corners(name: str, faces: NDArray[np.int64], good: NDArray[np.bool_]) -> None:
    wrong = (faces < 0) | (faces >= len(good))
    if wrong.any():
        raise Malformed(
            f"A face of {name} names vertex {int(faces[wrong][0])}; there are {len(good)}, the first is 0.",
            "Mend or re-export the mesh.",
        )
    if not good[faces].all():
        corner = int(faces[~good[faces]][0])
        raise Malformed(f"A face of {name} needs vertex {corner}, which is NaN.", "Mend or re-export the mesh.")


def check_size(name: str, points: Array, limit: float) -> None:
    """Raises InvalidInput if `points` (n, 3), m, are none, or spread over more than `limit`, as in another unit."""
    if not len(points):
        raise InvalidInput(f"{name} holds no points or beams: its arrays have length 0.", "Check what was exported.")
    extent = float(np.ptp(points, axis=0).max())
    if extent > limit:
        raise InvalidInput(
            f"{name} is {extent:.4g} m long, as if it were in millimetres; the limit is {limit:g} m.",
            "Scale it to metres, and leave out points that are not the object's.",
        )


def check_count(name: str, count: int) -> int:
    """`count` of points or faces if a file may announce as many.

    Raises:
        InvalidInput: less than none, or more than MAX_POINTS.
    """
    if not 0 <= count <= MAX_POINTS:
        raise InvalidInput(f"{name} announces {count} points or faces; the limit is {MAX_POINTS}.", "Thin it out.")
    return count


def cut_short(name: str, there: int, announced: int, what: str) -> Malformed:
    """The error for a file that ends after `there` of `announced` things."""
    return Malformed(f"{name} ends after {there} of the {announced} {what} that it announces.", "Write the file again.")
