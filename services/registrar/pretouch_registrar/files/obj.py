"""Reads OBJ files (Wavefront): vertices and faces."""

from __future__ import annotations

import numpy as np

from pretouch_registrar.files.polygons import fans
from pretouch_registrar.files.shape import Shape, make_shape
from pretouch_registrar.files.text_rows import TextRows, flatten, normalise_line_ends


def read_obj(name: str, data: bytes) -> Shape:
    """Vertices and faces of an OBJ file; polygons are cut into fans, all else is skipped. No face: a cloud.

    Raises:
        Malformed: a vertex or face that cannot be read.
    """
    rows = TextRows(name, normalise_line_ends(data).replace(b"\\\r\n", b"  ").replace(b"\\\n", b"  "))
    vertices: list[tuple[float, float, float]] = []
    polygons: list[list[int]] = []
    for line in rows:
        words = line.decode("latin-1").split()
        if words[0] == "v":
            vertices.append(_vertex(rows, words[1:4]))
        elif words[0] == "f":
            polygons.append(_face(rows, words[1:], len(vertices)))
    faces = fans(*flatten(polygons)) if polygons else None
    return make_shape(name, np.array(vertices, dtype=np.float64).reshape(-1, 3), faces)


def _vertex(rows: TextRows, words: list[str]) -> tuple[float, float, float]:
    if len(words) < 3:
        rows.refuse(f"a vertex of {len(words)} numbers")
    x, y, z = rows.numbers(words)
    return x, y, z


def _face(rows: TextRows, words: list[str], vertices: int) -> list[int]:
    """Indices of `7`, `7/2`, `7//3`, or `-1`, which counts from the last."""
    corners = rows.whole_numbers([word.split("/")[0] for word in words])
    if 0 in corners:
        rows.refuse("a face names vertex 0; the first is 1")
    return [corner - 1 if corner > 0 else vertices + corner for corner in corners]
