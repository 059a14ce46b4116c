"""Reads OFF files (Geomview's object file format): text, with or without colours and normals."""

from __future__ import annotations

import re

from pretouch.errors import Malformed
from pretouch_registrar.files.polygons import fans
from pretouch_registrar.files.shape import Shape, check_count, make_shape
from pretouch_registrar.files.text_rows import TextRows, flatten, normalise_line_ends

_HEADER = re.compile(rb"(?:ST)?C?N?OFF\b")
_COMMENT = re.compile(rb"#[^\n]*")


def read_off(name: str, data: bytes) -> Shape:
    """Vertices and faces of an OFF file; polygons are cut into fans, colours and normals are skipped.

    Raises:
        Malformed: no OFF file of text in three dimensions, or cut short.
    """
    text = _COMMENT.sub(b"", normalise_line_ends(data))
    found = _HEADER.match(text.lstrip())
    if found is None or text.lstrip()[found.end() :].lstrip(b" \t").startswith(b"BINARY"):
        raise Malformed(f"{name} does not begin with 'OFF'.", "Export it as OFF, as text.")
    rows = TextRows(name, text, text.index(found[0]) + found.end())  # counts may follow on the header's own line
    sizes = rows.whole_numbers(next(rows.words(1, "lines of counts")))
    if len(sizes) < 2:
        rows.refuse("the numbers of vertices and faces are due")
    vertices, faces = (check_count(name, size) for size in sizes[:2])
    points = rows.columns(vertices, [0, 1, 2], "vertices")
    polygons = [rows.polygon(words) for words in rows.words(faces, "faces")]
    return make_shape(name, points, fans(*flatten(polygons)) if polygons else None)
