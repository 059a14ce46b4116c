"""Reads PCD files of the Point Cloud Library, version 0.7: ASCII, binary, and binary compressed with LZF."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch.errors import Malformed
from pretouch.geometry import MAX_DISTANCE
from pretouch_registrar.files.shape import Shape, check_count, cut_short, make_shape
from pretouch_registrar.files.text_rows import TextRows

_LONGEST_HEADER = 64 * 1024
_KINDS = {"F": "f", "I": "i", "U": "u"}
_MOST_VALUES = 10_000
"""Of one field of one point: the longest feature descriptors have hundreds."""
_MOST_PACKING = 100
"""Bytes that LZF makes of one: up to 264 of three."""
_UNSAID = np.array([0.0, 0, 0, 1, 0, 0, 0])
"""The viewpoint that is written where none is known."""


def read_pcd(name: str, data: bytes) -> Shape:
    """The points of a PCD file's bytes, and the position of its VIEWPOINT.

    Raises:
        Malformed: not a PCD file, cut short, or without x, y and z.
    """
    header, body = _header(name, data)
    fields, dtypes, counts = _layout(name, header)
    missing = [axis for axis in "xyz" if axis not in fields]
    if missing:
        raise Malformed(f"The points of {name} have no {', '.join(missing)}.", "Export points with coordinates.")
    columns = [fields.index(axis) for axis in "xyz"]
    count = check_count(name, _count(name, header))
    kind = " ".join(header["DATA"])
    dtype = np.dtype([(f"{k}", one, (n,)) for k, (one, n) in enumerate(zip(dtypes, counts, strict=True))])
    remarks: tuple[str, ...] = ()
    if kind == "ascii":
        starts = np.cumsum([0, *counts])
        rows = TextRows(name, data, body)
        points = rows.columns(count, [int(starts[k]) for k in columns], "points")
        remarks = (f"trailing lines ignored: {left}.",) if (left := rows.count_remaining()) else ()
    elif kind == "binary_compressed":
        points = _columns_apart(_decompress(name, data, body, dtype.itemsize * count), dtype, count, columns)
    elif kind == "binary":
        there = (len(data) - body) // dtype.itemsize
        if there < count:
            raise cut_short(name, there, count, "points")
        points = _rows(data[body:], dtype, count, columns)
        left = len(data) - body - dtype.itemsize * count
        remarks = (f"trailing bytes ignored: {left}.",) if left else ()
    else:
        raise Malformed(f"{name} holds DATA {kind!r}.", "Write it as ascii, binary or binary_compressed.")
    return make_shape(name, points, None, _viewpoint(header), remarks)


def _layout(name: str, header: dict[str, list[str]]) -> tuple[list[str], list[str], list[int]]:
    """The fields' names, their types as numpy writes them, and how many values each has."""
    for key in ("FIELDS", "SIZE", "TYPE"):
        if key not in header:
            raise _broken(name, f"has no line {key}")
    fields = header["FIELDS"]
    try:
        counts = [int(count) for count in header.get("COUNT", ["1"] * len(fields))]
        dtypes = [
            np.dtype(f"<{_KINDS[kind]}{int(size)}").str
            for _, kind, size, _ in zip(fields, header["TYPE"], header["SIZE"], counts, strict=True)
        ]
    except (KeyError, ValueError, TypeError) as error:
        raise _broken(name, "has lines FIELDS, SIZE, TYPE and COUNT that do not fit together") from error
    if min(counts) < 1 or max(counts) > _MOST_VALUES:
        raise _broken(name, f"has a COUNT of {' '.join(map(str, counts))}")
    return fields, dtypes, counts


def _count(name: str, header: dict[str, list[str]]) -> int:
    try:
        return int(header["POINTS"][0]) if "POINTS" in header else int(header["WIDTH"][0]) * int(header["HEIGHT"][0])
    except (KeyError, ValueError, IndexError) as error:
        raise _broken(name, "does not say its number of POINTS, or WIDTH and HEIGHT") from error


def _viewpoint(header: dict[str, list[str]]) -> NDArray[np.float64] | None:
    """(3,); None if the file does not say, or says what is written where none is known."""
    viewpoint = np.array(header.get("VIEWPOINT", _UNSAID), dtype=np.float64)
    return None if np.array_equal(viewpoint, _UNSAID) else viewpoint[:3]


def _check_viewpoint(name: str, line: int, words: list[str]) -> None:
    """Raises Malformed unless `words` are a position, m, and a quaternion."""
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    if len(numbers) != 7 or not all(abs(number) <= MAX_DISTANCE for number in numbers):
        raise Malformed(
            f"{name}, line {line}: VIEWPOINT is {' '.join(words)[:60]!r}, not a position in metres and a quaternion.",
            "Write 7 finite numbers: x y z qw qx qy qz; 0 0 0 1 0 0 0 where it is not known.",
        )


def _broken(name: str, how: str) -> Malformed:
    return Malformed(f"The header of {name} {how}.", "Write it as PCD 0.7.")


def _header(name: str, data: bytes) -> tuple[dict[str, list[str]], int]:
    header: dict[str, list[str]] = {}
    at, number = 0, 0
    while at < min(len(data), _LONGEST_HEADER):
        end = data.find(b"\n", at)
        if end < 0:
            break
        words = data[at:end].decode("latin-1").split()
        at, number = end + 1, number + 1
        if words and not words[0].startswith("#"):
            header[words[0].upper()] = words[1:]
            if words[0].upper() == "VIEWPOINT":
                _check_viewpoint(name, number, words[1:])
            if words[0].upper() == "DATA":
                return header, at
    raise _broken(name, "has no line DATA")


def _rows(raw: bytes, dtype: np.dtype[np.void], count: int, columns: list[int]) -> NDArray[np.float64]:
    table = np.frombuffer(raw, dtype, count)
    return np.stack([table[f"{k}"][:, 0].astype(np.float64) for k in columns], axis=1)


def _columns_apart(raw: bytes, dtype: np.dtype[np.void], count: int, columns: list[int]) -> NDArray[np.float64]:
    """Compressed files hold the first field of all points, then the second, and so on."""
    fields = [dtype[field] for field in dtype.names or ()]
    starts = np.cumsum([0, *(field.itemsize * count for field in fields)])
    return np.stack(
        [
            np.frombuffer(raw, fields[k].base, count * fields[k].shape[0], int(starts[k]))
            .reshape(count, -1)[:, 0]
            .astype(np.float64)
            for k in columns
        ],
        axis=1,
    )


def _decompress(name: str, data: bytes, at: int, wanted: int) -> bytes:
    packed, size = (int(n) for n in np.frombuffer(data.ljust(at + 8, b"\0"), "<u4", 2, at))
    if len(data) < at + 8 + packed:
        raise Malformed(f"{name} ends at byte {len(data)} of {at + 8 + packed}.", "Write the file again.")
    if size != wanted:
        raise Malformed(f"{name} holds {size} bytes where its header announces {wanted}.", "Write the file again.")
    if size > _MOST_PACKING * packed:
        raise Malformed(f"{name} announces more bytes than compressed data can hold.", "Write the file again.")
    out = np.zeros(size, dtype=np.uint8)
    if _expand(np.frombuffer(data, np.uint8, packed, at + 8), out) != size:
        raise Malformed(f"{name} holds damaged compressed data.", "Write the file again.")
    return out.tobytes()


@njit(cache=True, nogil=True)
def _expand(packed: NDArray[np.uint8], out: NDArray[np.uint8]) -> int:
    """Undoes LZF (Marc Lehmann): how many bytes came out, -1 if the data makes no sense.

    A byte below 32 announces that many bytes and one as they are; any other a copy from before: length in its upper
    three bits (7: more in the next byte) and 2, distance in its lower five bits and the next byte, and 1.
    """
    i = o = 0
    while i < packed.size:
        control = int(packed[i])
        i += 1
        if control < 32:
            length, source = control + 1, i
            if i + length > packed.size or o + length > out.size:
                return -1
            for k in range(length):
                out[o + k] = packed[source + k]
            i += length
        else:
            length = control >> 5
            if length == 7:
                if i >= packed.size:
                    return -1
                length += int(packed[i])
                i += 1
            if i >= packed.size:
                return -1
            length += 2
            source = o - ((control & 31) << 8) - int(packed[i]) - 1
            i += 1
            if source < 0 or o + length > out.size:
                return -1
            for k in range(length):
                out[o + k] = out[source + k]
        o += length
    return o
