"""Files of points and triangles as other programs write them."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np

from pretouch.geometry import Array

PLY = "ply\nformat {} 1.0\ncomment made by hand\nelement vertex 3\n{}end_header\n"
XYZ = "property float x\nproperty float y\nproperty float z\n"
ROWS = "0 0 0\n1 0 0\n0 1 0\n"
FACES = "element face 1\nproperty list uchar int vertex_index\n"
MESH_PLY = PLY.format("ascii", XYZ + FACES)
STL = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid\n"


def written(path: Path, data: bytes | str) -> Path:
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    return path


def binary_ply(points: Array) -> bytes:
    header = PLY.replace("vertex 3", f"vertex {len(points)}").format("binary_little_endian", XYZ)
    return header.encode() + points.astype("<f4").tobytes()


def lzf(data: bytes) -> bytes:
    """Compressed as LZF, by copies of what was seen at the last place with the same three bytes."""
    out, literals, seen, at = bytearray(), bytearray(), dict[bytes, int](), 0

    def flush() -> None:
        for start in range(0, len(literals), 32):
            part = literals[start : start + 32]
            out.extend((len(part) - 1, *part))
        literals.clear()

    while at < len(data):
        before = seen.get(data[at : at + 3], -1) if at + 3 <= len(data) else -1
        seen[data[at : at + 3]] = at
        if before < 0 or at - before > 8191:
            literals.append(data[at])
            at += 1
            continue
        flush()
        length = 3
        while length < 264 and at + length < len(data) and data[before + length] == data[at + length]:
            length += 1
        distance = at - before - 1
        out.append((min(length - 2, 7) << 5) | distance >> 8)
        if length - 2 >= 7:
            out.append(length - 9)
        out.append(distance & 255)
        at += length
    flush()
    return bytes(out)


def compressed_pcd(points: Array) -> bytes:
    raw = np.ascontiguousarray(points.T.astype("<f4")).tobytes()
    packed = lzf(raw)
    n = str(len(points))
    header = pcd("binary_compressed", "", WIDTH=n, POINTS=n).encode()
    return header + np.array([len(packed), len(raw)], dtype="<u4").tobytes() + packed


def text_rows(points: Array) -> str:
    return "".join(" ".join(map(repr, row)) + "\n" for row in points.tolist())


def pcd(data: str, body: str, **changes: str) -> str:
    header = {
        "VERSION": "0.7", "FIELDS": "x y z", "SIZE": "4 4 4", "TYPE": "F F F", "COUNT": "1 1 1", "WIDTH": "2",
        "HEIGHT": "1", "VIEWPOINT": "0 0 0 1 0 0 0", "POINTS": "2", "DATA": data,
    } | changes  # fmt: skip
    return "# .PCD v0.7\n" + "".join(f"{key} {value}\n" for key, value in header.items()) + body


def glb_of(document: str, version: int = 2) -> bytes:
    """A GLB file of this JSON alone."""
    chunk = document.encode() + b" " * (-len(document) % 4)
    header = b"glTF" + np.array([version, 20 + len(chunk), len(chunk)], "<u4").tobytes()
    return header + b"JSON" + chunk


def zip_of(member: str, content: bytes, stated_size: int | None = None) -> bytes:
    """A ZIP archive of one member, whose directory may state another size than it has."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr(member, content)
        if stated_size is not None:
            archive.filelist[0].file_size = stated_size
    return stream.getvalue()


def faces_file(tmp_path: Path, binary: bool) -> Path:
    """Five points; a triangle, a square and a pentagon with a quality each, after an element that nobody knows."""
    header = (
        f"ply\nformat {'binary_little_endian' if binary else 'ascii'} 1.0\nelement grid 2\n"
        f"property list uchar int cells\nelement vertex 5\n{XYZ}"
        "element face 3\nproperty uchar quality\nproperty list uchar int vertex_indices\n"
        "end_header\n"
    )
    vertices = np.arange(15.0).reshape(5, 3)
    polygons = [[0, 1, 2], [0, 1, 2, 3], [0, 1, 2, 3, 4]]
    if binary:
        grid = b"".join(bytes([n]) + np.arange(n, dtype="<i4").tobytes() for n in (2, 0))
        body = grid + vertices.astype("<f4").tobytes()
        body += b"".join(bytes([7, len(p)]) + np.array(p, dtype="<i4").tobytes() for p in polygons)
    else:
        rows = ["2 0 1", "0", *(" ".join(map(str, row)) for row in vertices)]
        rows += [" ".join(map(str, [7, len(p), *p])) for p in polygons]
        body = "\n".join(rows).encode()
    return written(tmp_path / "faces.ply", header.encode() + body)
