"""Reads STL files (3D Systems): ASCII and binary."""

from __future__ import annotations

import re
from typing import NoReturn

import numpy as np

from pretouch.errors import Malformed
from pretouch_registrar.files.shape import Shape, check_count, cut_short, make_shape
from pretouch_registrar.files.text_rows import TextRows, normalise_line_ends

_RECORD = np.dtype([("normal", "<f4", (3,)), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])
_HEADER = 84
_TEXT = re.compile(rb"\s*solid\b[^\0]*?\b(?:facet|endsolid)\b", re.IGNORECASE)
_VERTEX = re.compile(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", re.IGNORECASE)


def read_stl(name: str, data: bytes) -> Shape:
    """The triangles of an STL file; it is text if it begins as one, for binary ones may begin with `solid` too.

    Raises:
        Malformed: neither, or cut short.
    """
    return _read_text(name, normalise_line_ends(data)) if _TEXT.match(data[:2000]) else _read_binary(name, data)


def _read_binary(name: str, data: bytes) -> Shape:
    if len(data) < _HEADER:
        raise Malformed(f"{name} is no STL file: it is neither text nor {_HEADER} bytes long.", "Write the file again.")
    count = int(np.frombuffer(data, "<u4", 1, _HEADER - 4)[0])
    there, left = divmod(len(data) - _HEADER, _RECORD.itemsize)
    if there < count:
        raise cut_short(name, there, count, "triangles")
    left += (there - check_count(name, count)) * _RECORD.itemsize
    if not count:
        raise Malformed(f"{name} announces no triangle; {left} bytes follow.", "Write the file again.")
    corners = np.frombuffer(data, _RECORD, count, _HEADER)["corners"].reshape(-1, 3)
    remarks = (f"trailing bytes ignored: {left}.",) if left else ()
    return make_shape(name, corners, np.arange(len(corners)).reshape(-1, 3), remarks=remarks)


def _read_text(name: str, data: bytes) -> Shape:
    numbers = _VERTEX.findall(data)
    try:
        corners = np.array(numbers, dtype=np.float64).reshape(-1, 3)
    except ValueError:
        _refuse_text(name, data)
    loops = len(re.findall(rb"\bendloop\b", data, re.IGNORECASE))
    if not numbers:
        raise Malformed(f"{name} holds no facet.", "Export it as a triangle mesh.")
    if len(corners) != 3 * loops:
        _refuse_text(name, data)
    ended = re.search(rb"\bendsolid\b", data[-1000:], re.IGNORECASE)
    remarks = () if ended else ("it does not end with endsolid: it may be cut short.",)
    return make_shape(name, corners, np.arange(len(corners)).reshape(-1, 3), remarks=remarks)


def _refuse_text(name: str, data: bytes) -> NoReturn:
    """Raises Malformed for the first line that is wrong."""
    rows, corners = TextRows(name, data), 0
    for line in rows:
        words = line.decode("latin-1").split()
        if words[0].lower() == "vertex":
            corners += 1
            if len(words) != 4:
                rows.refuse(f"a corner of {len(words) - 1} numbers")
            rows.numbers(words[1:])
        elif words[0].lower() == "endloop":
            if corners != 3:
                rows.refuse(f"a facet of {corners} corners; STL knows triangles alone")
            corners = 0
    raise Malformed(f"{name}, line {rows.line}: it ends amid a facet.", "Write the file again.")
