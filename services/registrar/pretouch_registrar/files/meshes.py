"""Reads OBJ and STL files: the triangles of CAD programs."""

from __future__ import annotations

import re
from itertools import pairwise

import numpy as np

from pretouch.errors import Malformed
from pretouch_registrar.files.shape import Shape, checked_count, checked_shape, cut_short

_STL_RECORD = np.dtype([("normal", "<f4", (3,)), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])
_STL_HEADER = 84


def read_obj(name: str, data: bytes) -> Shape:
    """Vertices and faces of an OBJ file; polygons are cut into fans, all else is passed over.

    Raises:
        Malformed: a vertex or face that cannot be read.
    """
    vertices: list[list[float]] = []
    faces: list[list[int]] = []
    try:
        for line in data.decode("latin-1").splitlines():
            match line.split():
                case ["v", x, y, z, *_]:
                    vertices.append([float(x), float(y), float(z)])
                case ["f", first, *others]:
                    a, *rest = (_vertex(corner, len(vertices)) for corner in (first, *others))
                    faces.extend([a, b, c] for b, c in pairwise(rest))
    except ValueError as error:
        raise Malformed(f"{name} holds a line that is no vertex or face.", "Write the file again.") from error
    return checked_shape(name, np.array(vertices).reshape(-1, 3), np.array(faces, dtype=np.int64).reshape(-1, 3))


def _vertex(corner: str, count: int) -> int:
    """The index of `7`, `7/2`, `7//3`, or `-1`, which counts from the last."""
    index = int(corner.split("/")[0])
    return index - 1 if index > 0 else count + index


def read_stl(name: str, data: bytes) -> Shape:
    """The triangles of an STL file, ASCII or binary.

    Raises:
        Malformed: neither, or cut short.
    """
    if len(data) >= _STL_HEADER:
        count = int(np.frombuffer(data, "<u4", 1, 80)[0])
        if len(data) == _STL_HEADER + count * _STL_RECORD.itemsize:
            checked_count(name, count)
            corners = np.frombuffer(data, _STL_RECORD, count, _STL_HEADER)["corners"].reshape(-1, 3)
            return checked_shape(name, corners, np.arange(len(corners)).reshape(-1, 3))
    numbers = re.findall(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)", data) if data.startswith(b"solid") else []
    if not numbers or len(numbers) % 3:
        raise cut_short(name)
    try:
        corners = np.array(numbers, dtype=np.float64)
    except ValueError as error:
        raise Malformed(f"{name} holds a corner that is not three numbers.", "Write the file again.") from error
    return checked_shape(name, corners, np.arange(len(corners)).reshape(-1, 3))
