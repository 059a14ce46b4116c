"""Reads PLY files (Greg Turk, 1994): ASCII, binary little and big endian; points and polygons."""

from __future__ import annotations

import io
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pretouch.errors import Malformed
from pretouch_registrar.files.shape import Shape, checked_count, checked_shape, cut_short, read_columns

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_LISTS = ("vertex_indices", "vertex_index")
_LONGEST_HEADER = 64 * 1024


@dataclass
class _Element:
    """An element of the header; a property is (name, type of a list's length or None, type)."""

    name: str
    count: int
    properties: list[tuple[str, str | None, str]] = field(default_factory=list)

    @property
    def flat(self) -> bool:
        return all(length is None for _, length, _ in self.properties)


def read_ply(name: str, data: bytes) -> Shape:
    """The points and triangles of a PLY file's bytes; polygons are cut into fans.

    Raises:
        Malformed: not a PLY file, cut short, or without x, y and z.
    """
    order, elements, body = _header(name, data)
    points: NDArray[np.float64] | None = None
    faces: NDArray[np.int64] | None = None
    rows = _AsciiRows(name, data[body:]) if not order else _BinaryRows(name, data, body, order)
    for element in elements:
        names = [prop for prop, _, _ in element.properties]
        if not element.flat:
            polygons = rows.lists(element, _LISTS)
            if element.name == "face" and len(polygons):
                faces = polygons
        elif element.name == "vertex" and {"x", "y", "z"} <= set(names):
            points = rows.columns(element, [names.index(axis) for axis in "xyz"])
        else:
            rows.columns(element, [])
    if points is None:
        raise Malformed(f"{name} has no vertices with x, y and z.", "Export points with coordinates.")
    return checked_shape(name, points, faces)


def _header(name: str, data: bytes) -> tuple[str, list[_Element], int]:
    """Byte order ("" for ASCII), elements, and where the body begins."""
    end = data.find(b"end_header", 0, _LONGEST_HEADER)
    line_end = data.find(b"\n", end)
    broken = Malformed(f"{name} is not a readable PLY file.", "Export it as PLY 1.0, ASCII or binary.")
    if not data.startswith(b"ply") or end < 0 or line_end < 0:
        raise broken
    order: str | None = None
    elements: list[_Element] = []
    try:
        for line in data[:end].decode("latin-1").splitlines()[1:]:
            match line.split():
                case ["format", kind, _]:
                    order = _ORDERS[kind]
                case ["element", element, count]:
                    elements.append(_Element(element, checked_count(name, int(count))))
                case ["property", "list", length, kind, prop]:
                    elements[-1].properties.append((prop, _TYPES[length], _TYPES[kind]))
                case ["property", kind, prop]:
                    elements[-1].properties.append((prop, None, _TYPES[kind]))
    except (KeyError, ValueError, IndexError) as error:
        raise broken from error
    if order is None:
        raise broken
    return order, elements, line_end + 1


def _fans(counts: NDArray[np.int64], indices: NDArray[np.int64]) -> NDArray[np.int64]:
    """Triangles (m, 3) of polygons whose corners, `counts` each, follow each other in `indices`."""
    starts = np.cumsum(counts) - counts
    cuts = np.maximum(counts - 2, 0)
    polygon = np.repeat(np.arange(len(counts)), cuts)
    step = np.arange(len(polygon)) - np.repeat(np.cumsum(cuts) - cuts, cuts)
    first = starts[polygon]
    return np.stack([indices[first], indices[first + step + 1], indices[first + step + 2]], axis=1)


class _AsciiRows:
    """The body of an ASCII file, a row a line."""

    def __init__(self, name: str, data: bytes) -> None:
        self._name = name
        self._stream = io.BytesIO(data)

    def columns(self, element: _Element, wanted: list[int]) -> NDArray[np.float64]:
        """(count, wanted)."""
        return read_columns(self._name, self._stream, element.count, wanted or [0])

    def lists(self, element: _Element, names: tuple[str, ...]) -> NDArray[np.int64]:
        """Triangles of the list property with one of these names; (0, 3) without such."""
        counts, indices = [], []
        for _ in range(element.count):
            try:
                row = np.array(self._stream.readline().split(), dtype=np.float64)
            except ValueError as error:
                raise Malformed(f"{self._name} holds a face that cannot be read.", "Write the file again.") from error
            at = 0
            for name, length, _ in element.properties:
                size = 1 if length is None else 1 + int(row[at]) if at < len(row) else 1
                if name in names:
                    counts.append(size - 1)
                    indices.append(row[at + 1 : at + size])
                at += size
            if at != len(row) or not at:
                raise cut_short(self._name)
        if not counts:
            return np.zeros((0, 3), dtype=np.int64)
        return _fans(np.array(counts), np.concatenate(indices).astype(np.int64))


class _BinaryRows:
    """The body of a binary file."""

    def __init__(self, name: str, data: bytes, at: int, order: str) -> None:
        self._name = name
        self._data = data
        self._at = at
        self._order = order

    def _take(self, dtype: np.dtype[np.void], count: int) -> NDArray[np.void]:
        if self._at + dtype.itemsize * count > len(self._data):
            raise cut_short(self._name)
        values = np.frombuffer(self._data, dtype, count, self._at)
        self._at += dtype.itemsize * count
        return values

    def columns(self, element: _Element, wanted: list[int]) -> NDArray[np.float64]:
        """(count, wanted)."""
        dtype = np.dtype([(f"{k}", self._order + kind) for k, (_, _, kind) in enumerate(element.properties)])
        values = self._take(dtype, element.count)
        return np.array([values[f"{k}"] for k in wanted], dtype=np.float64).T

    def lists(self, element: _Element, names: tuple[str, ...]) -> NDArray[np.int64]:
        """Triangles of the list property with one of these names; (0, 3) without such.

        Rows of one shape, as all triangles, are read at once up to the first row of another shape, and so on.
        """
        counts: list[NDArray[np.int64]] = [np.zeros(0, dtype=np.int64)]
        indices: list[NDArray[np.int64]] = [np.zeros(0, dtype=np.int64)]
        left = element.count
        while left:
            dtype, sizes = self._row(element)
            fitting = min(left, max(1, (len(self._data) - self._at) // dtype.itemsize))
            start = self._at
            rows = self._take(dtype, fitting)
            same = np.ones(fitting, dtype=bool)
            for k, size in sizes.items():
                same &= rows[f"n{k}"] == size
            good = fitting if same.all() else int(np.argmin(same))
            for k, size in sizes.items():
                if element.properties[k][0] in names:
                    counts.append(np.full(good, size, dtype=np.int64))
                    indices.append(rows[f"v{k}"][:good].astype(np.int64).ravel())
            self._at = start + good * dtype.itemsize
            left -= good
        return _fans(np.concatenate(counts), np.concatenate(indices))

    def _row(self, element: _Element) -> tuple[np.dtype[np.void], dict[int, int]]:
        """The layout of the row that comes next, and the length of each of its lists."""
        fields: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
        sizes: dict[int, int] = {}
        at = self._at
        for k, (_, length, kind) in enumerate(element.properties):
            if length is not None:
                width = np.dtype(length).itemsize
                if at + width > len(self._data):
                    raise cut_short(self._name)
                size = int(np.frombuffer(self._data, self._order + length, 1, at)[0])
                sizes[k] = checked_count(self._name, size)
                fields.append((f"n{k}", self._order + length))
                fields.append((f"v{k}", self._order + kind, (size,)))
                at += width + size * np.dtype(kind).itemsize
            else:
                fields.append((f"s{k}", self._order + kind))
                at += np.dtype(kind).itemsize
            if at > len(self._data):
                raise cut_short(self._name)
        return np.dtype(fields), sizes
