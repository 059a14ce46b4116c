"""Reads PCD files of the Point Cloud Library, version 0.7: ASCII, binary, and binary compressed with LZF."""

from __future__ import annotations

import io

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch.errors import Malformed
from pretouch_registrar.files.shape import Shape, checked_count, checked_shape, cut_short, read_columns

_LONGEST_HEADER = 64 * 1024
_KINDS = {"F": "f", "I": "i", "U": "u"}
_UNSAID = np.array([0.0, 0, 0, 1, 0, 0, 0])
"""The viewpoint that is written where none is known."""


def read_pcd(name: str, data: bytes) -> Shape:
    """The points of a PCD file's bytes, and the position of its VIEWPOINT.

    Raises:
        Malformed: not a PCD file, cut short, or without x, y and z.
    """
    header, body = _header(name, data)
    try:
        fields = header["FIELDS"]
        sizes = [int(size) for size in header["SIZE"]]
        counts = [int(count) for count in header.get("COUNT", ["1"] * len(fields))]
        dtypes = [f"<{_KINDS[kind]}{size}" for kind, size in zip(header["TYPE"], sizes, strict=True)]
        count = int(header.get("POINTS", [str(int(header["WIDTH"][0]) * int(header["HEIGHT"][0]))])[0])
        viewpoint = np.array(header.get("VIEWPOINT", _UNSAID), dtype=np.float64)
        dtype = np.dtype([(f"{k}", kind, (n,)) for k, (kind, n) in enumerate(zip(dtypes, counts, strict=True))])
        columns = [fields.index(axis) for axis in "xyz"]
        (kind,) = header["DATA"]
    except (KeyError, ValueError, IndexError, TypeError) as error:
        raise _broken(name) from error
    checked_count(name, count)
    if kind == "ascii":
        starts = np.cumsum([0, *counts])
        points = read_columns(name, io.BytesIO(data[body:]), count, [int(starts[k]) for k in columns])
    else:
        packed = kind == "binary_compressed"
        if not packed and kind != "binary":
            raise _broken(name)
        raw = _decompressed(name, data, body, dtype.itemsize * count) if packed else data[body:]
        if len(raw) < dtype.itemsize * count:
            raise cut_short(name)
        points = _columns_apart(raw, dtype, count, columns) if packed else _rows(raw, dtype, count, columns)
    known = viewpoint.shape == (7,) and np.isfinite(viewpoint).all() and not np.array_equal(viewpoint, _UNSAID)
    return checked_shape(name, points, None, viewpoint[:3] if known else None)


def _broken(name: str) -> Malformed:
    return Malformed(f"{name} is not a readable PCD file with x, y and z.", "Write it as PCD 0.7.")


def _header(name: str, data: bytes) -> tuple[dict[str, list[str]], int]:
    header: dict[str, list[str]] = {}
    at = 0
    while at < min(len(data), _LONGEST_HEADER):
        end = data.find(b"\n", at)
        if end < 0:
            break
        words = data[at:end].decode("latin-1").split()
        at = end + 1
        if words and not words[0].startswith("#"):
            header[words[0].upper()] = words[1:]
            if words[0].upper() == "DATA":
                return header, at
    raise _broken(name)


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


def _decompressed(name: str, data: bytes, at: int, wanted: int) -> bytes:
    if len(data) < at + 8:
        raise cut_short(name)
    packed, size = (int(n) for n in np.frombuffer(data, "<u4", 2, at))
    if len(data) < at + 8 + packed or size < wanted:
        raise cut_short(name)
    if size != wanted:
        raise _broken(name)
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
