"""Reads PLY files (Greg Turk, 1994): ASCII, binary little and big endian; points and polygons."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from pretouch.errors import Malformed
from pretouch_registrar.files.polygons import fans
from pretouch_registrar.files.shape import Shape, check_count, cut_short, make_shape
from pretouch_registrar.files.text_rows import TextRows, normalise_line_ends

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_LISTS = ("vertex_indices", "vertex_index")
_LONGEST_HEADER = 64 * 1024
_FIRST_CHUNK = 1024


@dataclass
class _Element:
    """An element of the header; a property is (name, type of a list's length or None, type)."""

    name: str
    count: int
    properties: list[tuple[str, str | None, str]] = field(default_factory=list)

    @property
    def flat(self) -> bool:
        return all(length is None for _, length, _ in self.properties)

    def index(self, *names: str) -> int | None:
        """Which property has one of these names."""
        return next((k for k, (name, _, _) in enumerate(self.properties) if name in names), None)


class _Rows(NamedTuple):
    """Rows of an element: wanted numbers (n, k), and the wanted list of each, its `indices` one row after the other."""

    columns: NDArray[np.float64]
    counts: NDArray[np.int64]
    indices: NDArray[np.int64]


def read_ply(name: str, data: bytes) -> Shape:
    """The points and triangles of a PLY file's bytes; polygons are cut into fans.

    Raises:
        Malformed: not a PLY file, cut short, or without x, y and z.
    """
    order, elements, body = _header(name, data)
    if not order:
        data = normalise_line_ends(data)
    reader = _BinaryReader(name, data, body, order) if order else _TextReader(name, data, body)
    points: NDArray[np.float64] | None = None
    faces: NDArray[np.int64] | None = None
    for element in elements:
        axes = [element.index(axis) for axis in "xyz"] if element.name == "vertex" else []
        missing = [axis for axis, column in zip("xyz", axes, strict=False) if column is None]
        if missing:
            raise Malformed(f"The vertices of {name} have no {', '.join(missing)}.", "Export points with coordinates.")
        corners = element.index(*_LISTS) if element.name == "face" else None
        rows = reader.read(element, [column for column in axes if column is not None], corners)
        if element.name == "vertex":
            points = rows.columns
        elif corners is not None:
            faces = fans(rows.counts, rows.indices)
    if points is None:
        raise Malformed(f"{name} has no vertices.", "Export points with coordinates.")
    if faces is None and any(element.name == "tristrips" for element in elements):
        raise Malformed(f"{name} holds triangle strips (tristrips) instead of faces.", "Export it as triangles.")
    return make_shape(name, points, faces, remarks=reader.remarks())


def _header(name: str, data: bytes) -> tuple[str, list[_Element], int]:
    """Byte order ("" for ASCII), elements, and where the body begins."""
    if not data.startswith(b"ply"):
        raise Malformed(f"{name} does not begin with 'ply'.", "Export it as PLY 1.0, ASCII or binary.")
    end_of_line = b"\r" if data[3:4] == b"\r" and data[4:5] != b"\n" else b"\n"
    order: str | None = None
    elements: list[_Element] = []
    at, number = 0, 0
    while at < min(len(data), _LONGEST_HEADER) and (end := data.find(end_of_line, at)) >= 0:
        words = data[at:end].decode("latin-1").split()
        at, number = end + 1, number + 1
        try:
            match words:
                case ["end_header"]:
                    if order is None:
                        raise Malformed(f"The header of {name} names no format.", "Export it as PLY 1.0.")
                    return order, elements, at
                case ["format", kind, _]:
                    order = _ORDERS[kind]
                case ["element", element, count]:
                    elements.append(_Element(element, check_count(name, int(count))))
                case ["property", "list", "float" | "float32" | "double" | "float64" as length, _, prop]:
                    raise Malformed(
                        f"{name}, line {number}: the length of the list {prop} is of type {length}, no whole number.",
                        "Write it as: property list uchar int vertex_indices.",
                    )
                case ["property", "list", length, kind, prop]:
                    elements[-1].properties.append((prop, _TYPES[length], _TYPES[kind]))
                case ["property", kind, prop]:
                    elements[-1].properties.append((prop, None, _TYPES[kind]))
                case ["format" | "element" | "property", *_]:
                    raise ValueError
        except (KeyError, ValueError, IndexError) as error:
            raise Malformed(
                f"{name}, line {number}: {' '.join(words)[:60]!r} cannot be understood.",
                "Export it as PLY 1.0, ASCII or binary.",
            ) from error
    raise Malformed(f"The header of {name} has no end_header.", "Export it as PLY 1.0, ASCII or binary.")


class _TextReader:
    """The body of an ASCII file, a row a line."""

    def __init__(self, name: str, data: bytes, at: int) -> None:
        self._rows = TextRows(name, data, at)

    def read(self, element: _Element, columns: list[int], corners: int | None) -> _Rows:
        what = f"rows of the element {element.name}"
        nothing = np.zeros(0, dtype=np.int64)
        if element.flat and element.properties:
            return _Rows(self._rows.columns(element.count, columns or [0], what), nothing, nothing)
        numbers: list[list[float]] = []
        counts: list[int] = []
        indices: list[int] = []
        for words in self._rows.words(element.count, what):
            at = [0]
            for _, length, _ in element.properties:
                size = 0 if length is None or at[-1] >= len(words) else self._count(words[at[-1]])
                at.append(at[-1] + 1 + size)
            if at[-1] != len(words):
                self._rows.refuse(f"it holds {len(words)} numbers where {at[-1]} are due")
            numbers.append(self._rows.numbers([words[at[k]] for k in columns]))
            if corners is not None:
                polygon = self._rows.whole_numbers(words[at[corners] + 1 : at[corners + 1]])
                counts.append(len(polygon))
                indices += polygon
        return _Rows(
            np.array(numbers, dtype=np.float64).reshape(element.count, len(columns)),
            np.array(counts, dtype=np.int64),
            np.array(indices, dtype=np.int64),
        )

    def remarks(self) -> tuple[str, ...]:
        left = self._rows.count_remaining()
        return (f"trailing lines ignored: {left}.",) if left else ()

    def _count(self, word: str) -> int:
        (count,) = self._rows.whole_numbers([word])
        if count < 0:
            self._rows.refuse(f"a list of {count}")
        return count


class _BinaryReader:
    """The body of a binary file."""

    def __init__(self, name: str, data: bytes, at: int, order: str) -> None:
        self._name = name
        self._data = data
        self._body = self._at = at
        self._order = order

    def read(self, element: _Element, columns: list[int], corners: int | None) -> _Rows:
        """Rows of one shape, as all triangles, are read at once up to the first row of another shape, and so on."""
        found = [_Rows(np.zeros((0, len(columns))), np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64))]
        done, chunk = 0, element.count if element.flat else _FIRST_CHUNK
        while done < element.count and element.properties:
            dtype, sizes = self._row(element, done)
            fitting = min(element.count - done, chunk, (len(self._data) - self._at) // dtype.itemsize)
            if fitting == 0 or (element.flat and fitting < element.count):
                self._refuse_end(element, done + fitting)
            rows = np.frombuffer(self._data, dtype, fitting, self._at)
            same = np.ones(fitting, dtype=bool)
            for k, size in sizes.items():
                same &= rows[f"n{k}"] == size
            good = fitting if same.all() else int(np.argmin(same))
            rows = rows[:good]
            found.append(
                _Rows(
                    np.array([rows[f"v{k}"] for k in columns], dtype=np.float64).reshape(len(columns), good).T,
                    np.full(good if corners is not None else 0, sizes.get(corners or 0, 0), dtype=np.int64),
                    rows[f"v{corners}"].astype(np.int64).ravel() if corners is not None else found[0].indices,
                )
            )
            self._at += good * dtype.itemsize
            done += good
            chunk = 2 * good + 16  # rows of changing shape must not be looked at again and again
        return _Rows(*(np.concatenate(parts) for parts in zip(*found, strict=True)))

    def remarks(self) -> tuple[str, ...]:
        left = len(self._data) - self._at
        return (f"trailing bytes ignored: {left}.",) if left else ()

    def _row(self, element: _Element, done: int) -> tuple[np.dtype[np.void], dict[int, int]]:
        """The layout of the row that comes next, and the length of each of its lists."""
        fields: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
        sizes: dict[int, int] = {}
        at = self._at
        for k, (_, length, kind) in enumerate(element.properties):
            if length is not None:
                width = np.dtype(length).itemsize
                if at + width > len(self._data):
                    self._refuse_end(element, done)
                size = int(np.frombuffer(self._data, self._order + length, 1, at)[0])
                if not 0 <= size <= len(self._data):
                    raise Malformed(f"{self._name}, byte {at}: a list of {size} numbers.", "Write the file again.")
                sizes[k] = size
                fields.append((f"n{k}", self._order + length))
                fields.append((f"v{k}", self._order + kind, (size,)))
                at += width + size * np.dtype(kind).itemsize
            else:
                fields.append((f"v{k}", self._order + kind))
                at += np.dtype(kind).itemsize
        if at > len(self._data):
            self._refuse_end(element, done)
        return np.dtype(fields), sizes

    def _refuse_end(self, element: _Element, there: int) -> NoReturn:
        body = self._data[self._body : self._body + 200]
        if body and all(byte in b"0123456789+-.eE \t\r\n" for byte in body):
            raise Malformed(f"{self._name} holds text, although its header says binary.", "Write the file again.")
        raise cut_short(self._name, there, element.count, f"rows of the element {element.name}")
