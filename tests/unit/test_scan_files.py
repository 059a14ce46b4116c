"""Point files of other tools: read exactly, or refused with a remedy."""

from __future__ import annotations

import gzip
import os
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pretouch_registrar.files import read_shape
from pretouch_simulation.mesh import Mesh
from pretouch_simulation.objects import MAKERS

from pretouch.errors import InvalidInput, Malformed, NotFound, PretouchError
from pretouch.geometry import Array

POINTS = np.random.default_rng(0).uniform(-1, 1, (300, 3)).astype(np.float32).astype(np.float64)
MUG = MAKERS["mug"]()
PLY = "ply\nformat {} 1.0\ncomment made by hand\nelement vertex 3\n{}end_header\n"
XYZ = "property float x\nproperty float y\nproperty float z\n"


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


CLOUDS: dict[str, tuple[str, Callable[[], bytes]]] = {
    "ascii ply": (
        "a.ply",
        lambda: (PLY.replace("vertex 3", "vertex 300").format("ascii", XYZ) + text_rows(POINTS)).encode(),
    ),
    "binary ply": ("a.ply", lambda: binary_ply(POINTS)),
    "ascii pcd": ("a.pcd", lambda: pcd("ascii", text_rows(POINTS), WIDTH="300", POINTS="300").encode()),
    "binary pcd": (
        "a.pcd",
        lambda: pcd("binary", "", WIDTH="300", POINTS="300").encode() + POINTS.astype("<f4").tobytes(),
    ),
    "compressed pcd": ("a.pcd", lambda: compressed_pcd(POINTS)),
    "obj": ("a.obj", lambda: "".join(f"v {row}\n" for row in text_rows(POINTS).splitlines()).encode()),
    "ply of trimesh": ("a.ply", lambda: trimesh.PointCloud(POINTS).export(file_type="ply")),
    "glb of trimesh": ("a.glb", lambda: trimesh.Scene([trimesh.PointCloud(POINTS)]).export(file_type="glb")),
}


@pytest.mark.parametrize("kind", CLOUDS)
def test_clouds_are_read_as_clouds(tmp_path: Path, kind: str) -> None:
    name, data = CLOUDS[kind]
    read = read_shape(written(tmp_path / name, data()))
    np.testing.assert_array_equal(read.points, POINTS)
    assert (read.faces, read.viewpoint, read.remarks) == (None, None, ())


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(1, 3000), st.integers(1, 500), st.integers(0, 99))
def test_compressed_clouds_of_any_likeness_are_read(tmp_path: Path, count: int, period: int, seed: int) -> None:
    few = np.random.default_rng(seed).uniform(-1, 1, (period, 3)).astype(np.float32)
    points = few[np.arange(count) % period].astype(np.float64)
    read = read_shape(written(tmp_path / "cloud.pcd", compressed_pcd(points)))
    np.testing.assert_array_equal(read.points, points)


@pytest.mark.parametrize("kind", ["ply", "ply ascii", "obj", "stl", "stl_ascii", "off", "glb", "3mf"])
def test_meshes_of_another_library_are_read_to_the_triangle(tmp_path: Path, kind: str) -> None:
    written_by = trimesh.Trimesh(MUG.vertices, MUG.faces, process=False)
    options = {"encoding": "ascii"} if kind == "ply ascii" else {}
    data = written_by.export(file_type=kind.split()[0], **options)
    read = read_shape(written(tmp_path / f"mesh.{kind[:3]}", data))
    assert read.faces is not None
    scale = 1000 if kind == "3mf" else 1  # it states its unit, and trimesh writes that it were mm
    np.testing.assert_allclose(scale * read.points[read.faces], MUG.vertices[MUG.faces], atol=2e-6)


def test_the_parts_of_a_scene_are_put_in_their_places(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    for x in (0.0, 0.5):
        pose = np.eye(4)
        pose[0, 3] = x
        scene.add_geometry(trimesh.creation.box((0.1, 0.1, 0.1)), transform=pose)
    read = read_shape(written(tmp_path / "two.glb", scene.export(file_type="glb")))
    assert read.faces is not None
    np.testing.assert_allclose(np.ptp(read.points, axis=0), [0.6, 0.1, 0.1], atol=1e-6)
    assert len(read.faces) == 24


@pytest.mark.parametrize(("order", "numpy_order"), [("little", "<"), ("big", ">")])
@pytest.mark.parametrize(("kind", "numpy_kind"), [("float", "f4"), ("double", "f8"), ("int16", "i2")])
def test_a_binary_ply_of_either_order_and_any_type_is_read(
    tmp_path: Path, order: str, numpy_order: str, kind: str, numpy_kind: str
) -> None:
    dtype = np.dtype([("red", "u1"), *((axis, numpy_order + numpy_kind) for axis in "yxz")])
    rows = np.array([(9, 2, 1, 3), (9, 5, 4, 6), (9, 8, 7, 9)], dtype=dtype)
    properties = "property uchar red\n" + "".join(f"property {kind} {axis}\n" for axis in "yxz")
    header = PLY.format(f"binary_{order}_endian", properties)
    read = read_shape(written(tmp_path / "a.ply", header.encode() + rows.tobytes()))
    np.testing.assert_array_equal(read.points, [[1, 2, 3], [4, 5, 6], [7, 8, 9]])


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


@pytest.mark.parametrize("binary", [True, False])
def test_polygons_become_triangles(tmp_path: Path, binary: bool) -> None:
    read = read_shape(faces_file(tmp_path, binary))
    np.testing.assert_array_equal(read.points, np.arange(15.0).reshape(5, 3))
    assert read.faces is not None
    np.testing.assert_array_equal(read.faces, [[0, 1, 2], [0, 1, 2], [0, 2, 3], [0, 1, 2], [0, 2, 3], [0, 3, 4]])


def pcd(data: str, body: str, **changes: str) -> str:
    header = {
        "VERSION": "0.7", "FIELDS": "x y z", "SIZE": "4 4 4", "TYPE": "F F F", "COUNT": "1 1 1", "WIDTH": "2",
        "HEIGHT": "1", "VIEWPOINT": "0 0 0 1 0 0 0", "POINTS": "2", "DATA": data,
    } | changes  # fmt: skip
    return "# .PCD v0.7\n" + "".join(f"{key} {value}\n" for key, value in header.items()) + body


def test_a_pcd_says_where_it_was_seen_from_and_which_points_are_none(tmp_path: Path) -> None:
    changes = {"FIELDS": "rgb normal x y z", "SIZE": "4 4 4 4 4", "TYPE": "U F F F F", "COUNT": "1 3 1 1 1"}
    body = "7 0 0 1 0.1 0.2 0.3\n7 0 0 1 nan nan nan\n"
    read = read_shape(written(tmp_path / "a.pcd", pcd("ascii", body, **changes, VIEWPOINT="0.5 0 1 1 0 0 0")))
    np.testing.assert_array_equal(read.points, [[0.1, 0.2, 0.3]])
    np.testing.assert_array_equal(read.viewpoint, [0.5, 0, 1])
    assert read.remarks == ("points without coordinates left out: 1.",)


STL = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid\n"


def test_an_ascii_stl_is_read(tmp_path: Path) -> None:
    read = read_shape(written(tmp_path / "a.stl", STL))
    np.testing.assert_array_equal(read.points, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])


ROWS = "0 0 0\n1 0 0\n0 1 0\n"
BAD: dict[str, tuple[str, bytes | str, type[PretouchError]]] = {
    "another kind": ("a.xyz", "0 0 0", InvalidInput),
    "no suffix": ("a", "0 0 0", InvalidInput),
    "an empty ply": ("a.ply", "", Malformed),
    "a ply of text": ("a.ply", "hello", Malformed),
    "a ply without end": ("a.ply", "ply\nformat ascii 1.0\n", Malformed),
    "a ply of no format": ("a.ply", PLY.replace("format {} 1.0\n", "").format(XYZ) + ROWS, Malformed),
    "an unknown format": ("a.ply", PLY.format("zip", XYZ) + ROWS, Malformed),
    "an unknown type": ("a.ply", PLY.format("ascii", XYZ.replace("float", "quad")) + ROWS, Malformed),
    "no z": ("a.ply", PLY.format("ascii", XYZ.replace(" z", " w")) + ROWS, Malformed),
    "a ply cut short": ("a.ply", PLY.format("ascii", XYZ) + ROWS[:12], Malformed),
    "a ply without points": ("a.ply", PLY.replace("vertex 3", "vertex 0").format("ascii", XYZ), InvalidInput),
    "too many": ("a.ply", PLY.replace("vertex 3", "vertex 1" + "0" * 20).format("ascii", XYZ), InvalidInput),
    "a negative count": ("a.ply", PLY.replace("vertex 3", "vertex -3").format("ascii", XYZ) + ROWS, InvalidInput),
    "words for numbers": ("a.ply", PLY.format("ascii", XYZ) + ROWS.replace("1", "one"), Malformed),
    "a binary cut short": ("a.ply", PLY.format("binary_little_endian", XYZ) + "short", Malformed),
    "infinity": ("a.ply", PLY.format("ascii", XYZ) + ROWS.replace("1", "inf"), Malformed),
    "nothing but NaN": ("a.ply", PLY.format("ascii", XYZ) + 3 * "nan nan nan\n", InvalidInput),
    "another planet": ("a.ply", PLY.format("ascii", XYZ) + ROWS.replace("1", "1e30"), InvalidInput),
    "an empty pcd": ("a.pcd", "", Malformed),
    "a pcd of text": ("a.pcd", "hello\n" * 9, Malformed),
    "no data line": ("a.pcd", pcd("ascii", "").replace("DATA", "DATUM"), Malformed),
    "unknown data": ("a.pcd", pcd("zip", "0 0 0\n1 1 1\n"), Malformed),
    "no fields": ("a.pcd", pcd("ascii", "", FIELDS="a b c"), Malformed),
    "fields that do not fit": ("a.pcd", pcd("ascii", "", SIZE="4 4"), Malformed),
    "a size of 5": ("a.pcd", pcd("binary", 24 * "a", SIZE="5 5 5"), Malformed),
    "a pcd cut short": ("a.pcd", pcd("ascii", "0 0 0\n"), Malformed),
    "a binary pcd cut short": ("a.pcd", pcd("binary", 23 * "a"), Malformed),
    "a compressed pcd cut short": ("a.pcd", pcd("binary_compressed", "aaa"), Malformed),
    "a compressed lie": ("a.pcd", pcd("binary_compressed", "\x02\0\0\0\x18\0\0\0aa"), Malformed),
    "a face of no number": ("a.obj", "v 0 0 0\nf a b c\n", Malformed),
    "an empty obj": ("a.obj", "# nothing\n", InvalidInput),
    "an stl cut short": ("a.stl", STL.replace("vertex 1 0 0\n", ""), Malformed),
    "an stl of words": ("a.stl", STL.replace("1", "one"), Malformed),
    "an empty stl": ("a.stl", "", Malformed),
    "an stl without facets": ("a.stl", "solid a\nendsolid a\n", Malformed),
    "an empty off": ("a.off", "", Malformed),
    "an empty glb": ("a.glb", "", Malformed),
    "a glb cut short": ("a.glb", b"glTF\2\0\0\0\xff\0\0\0", Malformed),
    "a 3mf that is none": ("a.3mf", "hello", Malformed),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_a_bad_file_is_refused_with_what_to_do(tmp_path: Path, case: str) -> None:
    name, data, kind = BAD[case]
    with pytest.raises(PretouchError) as raised:
        read_shape(written(tmp_path / name, data))
    assert type(raised.value) is kind
    assert raised.value.remedy


FACES = "element face 1\nproperty list uchar int vertex_index\n"
MESH_PLY = PLY.format("ascii", XYZ + FACES)
BINARY = PLY.format("binary_little_endian", XYZ).encode() + bytes(36)
SAID: dict[str, tuple[str, bytes | str, str]] = {
    "a decimal comma": (
        "a.ply",
        PLY.format("ascii", XYZ) + "0 0 0\n0,41 0 0\n0 1 0\n",
        "line 10: '0,41' has a decimal comma",
    ),
    "a decimal comma in an obj": ("a.obj", "v 0 0 0\nv 0,5 0 0\n", "line 2: '0,5' has a decimal comma"),
    "a decimal comma in an stl": (
        "a.stl",
        STL.replace("vertex 1 0", "vertex 1,5 0"),
        "line 5: '1,5' has a decimal comma",
    ),
    "a decimal comma in an off": ("a.off", "OFF\n3 1 0\n0 0 0\n1,5 0 0\n0 1 0\n3 0 1 2\n", "line 4: '1,5' has"),
    "a decimal comma in a pcd": ("a.pcd", pcd("ascii", "0 0 0\n0 0,1 0\n"), "line 13: '0,1' has a decimal comma"),
    "commas between": ("a.ply", PLY.format("ascii", XYZ) + "0,0,0\n1,0,0\n", "at least 3 are due"),
    "a semicolon": ("a.ply", PLY.format("ascii", XYZ) + "0; 0; 0\n", "line 9: '0;' is no number"),
    "a word": ("a.ply", PLY.format("ascii", XYZ) + "0 0 0\n\n0 one 0\n", "line 11: 'one' is no number"),
    "two numbers": ("a.ply", PLY.format("ascii", XYZ) + "0 0 0\n0 0\n", "line 10: it holds 2 numbers"),
    "vertices that end": (
        "a.ply",
        PLY.format("ascii", XYZ) + "0 0 0\n0 0 0\n",
        "after 2 of the 3 rows of the element vertex",
    ),
    "bytes that end": ("a.ply", BINARY[:-1], "after 2 of the 3 rows of the element vertex"),
    "faces that end": ("a.ply", MESH_PLY + ROWS, "after 0 of the 1 rows of the element face"),
    "a face too short": ("a.ply", MESH_PLY + ROWS + "3 0 1\n", "line 14: it holds 3 numbers where 4 are due"),
    "a face of halves": ("a.ply", MESH_PLY + ROWS + "3 0 1.5 2\n", "line 14: '1.5' is no whole number"),
    "a corner too many": ("a.ply", MESH_PLY + ROWS + "3 0 1 9\n", "names vertex 9; there are 3"),
    "a NaN corner": (
        "a.ply",
        MESH_PLY + ROWS.replace("1 0 0", "nan 0 0") + "3 0 1 2\n",
        "needs vertex 1, which is NaN",
    ),
    "strips": ("a.ply", MESH_PLY.replace("face", "tristrips") + ROWS + "3 0 1 2\n", "triangle strips (tristrips)"),
    "no z": ("a.ply", PLY.format("ascii", XYZ.replace(" z", " w")) + ROWS, "have no z"),
    "an unknown type": (
        "a.ply",
        PLY.format("ascii", XYZ.replace("float y", "half y")) + ROWS,
        "line 6: 'property half y'",
    ),
    "text said to be binary": ("a.ply", PLY.format("binary_little_endian", XYZ) + ROWS, "holds text, although"),
    "binary said to be text": ("a.ply", BINARY.replace(b"binary_little_endian", b"ascii") + b"\n", "line 9"),
    "an infinite vertex": (
        "a.ply",
        PLY.format("ascii", XYZ) + ROWS.replace("1", "-inf"),
        "infinite coordinates at vertex 1",
    ),
    "a face of 0": ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", "line 4: a face names vertex 0"),
    "a vertex of two": ("a.obj", "v 0 0 0\nv 1 0\n", "line 2: a vertex of 2 numbers"),
    "a facet of four": ("a.stl", STL.replace("endloop", "vertex 1 1 0\nendloop"), "line 8: a facet of 4 corners"),
    "an stl that ends": ("a.stl", STL[: STL.index("vertex 0 1")], "line 5: it ends amid a facet"),
    "a binary stl that ends": ("a.stl", bytes(80) + b"\2\0\0\0" + bytes(60), "after 1 of the 2 triangles"),
    "a pcd without y": ("a.pcd", pcd("ascii", "", FIELDS="x q z"), "have no y"),
    "a pcd of another kind": ("a.pcd", pcd("zip", ""), "DATA 'zip'"),
    "gzip": ("a.ply", gzip.compress(b"ply"), "compressed with gzip"),
    "zip": ("a.obj", b"PK\3\4 and more", "ZIP archive"),
    "UTF-16": ("a.obj", "v 0 0 0".encode("utf-16"), "UTF-16"),
    "Git LFS": ("a.stl", "version https://git-lfs.github.com/spec/v1\n", "Git LFS"),
    "nothing": ("a.ply", "", "is empty"),
    "an OFF of two dimensions": ("a.off", "OFF\n2 0 0\n0 0\n1 1\n", "line 3: it holds 2 numbers"),
    "Draco": ("a.glb", b'glTF\2\0\0\0\0\0\0\0{"KHR_draco_mesh_compression"}', "Draco"),
}


@pytest.mark.parametrize("case", SAID)
def test_a_refusal_names_the_cause_and_where_it_is(tmp_path: Path, case: str) -> None:
    name, data, said = SAID[case]
    with pytest.raises(PretouchError) as raised:
        read_shape(written(tmp_path / name, data))
    assert said in str(raised.value)
    assert name in str(raised.value)


@pytest.mark.parametrize("name", ["a.ply", "a.pcd", "a.off", "a.stl"])
def test_what_a_header_announces_is_not_believed_before_it_is_there(tmp_path: Path, name: str) -> None:
    many = "49000000"
    content = {
        "a.ply": MESH_PLY.replace("vertex 3", f"vertex {many}"),
        "a.pcd": pcd("ascii", "0 0 0\n", WIDTH=many, POINTS=many),
        "a.off": f"OFF\n{many} {many} 0\n0 0 0\n",
        "a.stl": bytes(80) + np.array([int(many)], "<u4").tobytes(),
    }[name]
    path = written(tmp_path / name, content)
    tracemalloc.start()
    try:
        with pytest.raises(Malformed, match=f"of the {many}"):
            read_shape(path)
        assert tracemalloc.get_traced_memory()[1] < 20_000_000
    finally:
        tracemalloc.stop()


ODD: dict[str, tuple[str, bytes | str, str | None]] = {
    "a blank line before the faces": ("a.ply", MESH_PLY + ROWS + "\n3 0 1 2\n", None),
    "blank lines everywhere": ("a.ply", MESH_PLY + "\n" + ROWS.replace("\n", "\n\n") + " \n3 0 1 2\n\n", None),
    "CRLF": ("a.ply", (MESH_PLY + ROWS + "3 0 1 2\n").replace("\n", "\r\n"), None),
    "CR alone": ("a.ply", (MESH_PLY + ROWS + "3 0 1 2\n").replace("\n", "\r"), None),
    "a byte order mark": ("a.ply", "\ufeff" + MESH_PLY + ROWS + "3 0 1 2\n", None),
    "more lines than announced": ("a.ply", MESH_PLY + ROWS + "3 0 1 2\n1 2 3\n", "trailing lines ignored: 1."),
    "an unused NaN vertex": (
        "a.ply",
        MESH_PLY.replace("vertex 3", "vertex 4") + "nan nan nan\n" + ROWS + "3 1 2 3\n",
        "points without coordinates left out: 1.",
    ),
    "a list of each vertex": (
        "a.ply",
        MESH_PLY.replace("element face", "property list uchar int materials\nelement face")
        + "0 0 0 2 7 7\n1 0 0 0\n0 1 0 1 7\n3 0 1 2\n",
        None,
    ),
    "capital letters": ("a.stl", STL.upper(), None),
    "no name, tabs and CRLF": ("a.stl", STL.replace("solid a", "solid").replace(" ", "\t").replace("\n", "\r\n"), None),
    "a solid that does not end": (
        "a.stl",
        STL.replace("endsolid\n", ""),
        "it does not end with endsolid: it may be cut short.",
    ),
    "a binary file that says solid": (
        "a.stl",
        b"solid of a tool".ljust(80)
        + b"\1\0\0\0"
        + bytes(12)
        + np.array([0, 0, 0, 1, 0, 0, 0, 1, 0], "<f4").tobytes()
        + bytes(3),
        "trailing bytes ignored: 1.",
    ),
    "colours, normals and groups": (
        "a.obj",
        "o a\nv 0 0 0 1 1 1\nv 1 0 0 1\nvn 0 0 1\nv 0 1 0\nf 1//1 2/1 \\\n -1\n",
        None,
    ),
    "counts on the first line": (
        "a.off",
        "COFF 3 1 0 # made\n0 0 0 9 9 9 9\n1 0 0 9 9 9 9\n0 1 0 9 9 9 9\n3 0 1 2 255 0 0\n",
        None,
    ),
}


@pytest.mark.parametrize("case", ODD)
def test_what_other_tools_write_is_read_and_what_is_ignored_is_said(tmp_path: Path, case: str) -> None:
    name, data, remark = ODD[case]
    read = read_shape(written(tmp_path / name, data.encode() if isinstance(data, str) else data))
    assert read.faces is not None
    np.testing.assert_array_equal(read.points[read.faces], [[[0, 0, 0], [1, 0, 0], [0, 1, 0]]])
    assert read.remarks == ((remark,) if remark else ())


@pytest.mark.parametrize(
    "nan", ["nan", "-NaN", "-nan(ind)", "nan(snan)", "NAN(0x7ff8)", "1.#QNAN", "-1.#IND", "1.#QNAN0"]
)
@pytest.mark.parametrize("name", ["a.ply", "a.pcd", "a.obj"])
def test_not_a_number_has_many_spellings(tmp_path: Path, nan: str, name: str) -> None:
    rows = f"{nan} {nan} {nan}\n0.5 0 1\n"
    content = {
        "a.ply": PLY.replace("vertex 3", "vertex 2").format("ascii", XYZ) + rows,
        "a.pcd": pcd("ascii", rows),
        "a.obj": "".join(f"v {row}\n" for row in rows.splitlines()),
    }[name]
    read = read_shape(written(tmp_path / name, content))
    np.testing.assert_array_equal(read.points, [[0.5, 0, 1]])
    assert read.remarks == ("points without coordinates left out: 1.",)


@pytest.mark.skipif("PRETOUCH_SHARED" not in os.environ, reason="PRETOUCH_SHARED names no folder of shared data")
def test_the_shared_files_of_other_tools_are_read_or_refused_for_the_true_cause() -> None:
    folder = Path(os.environ["PRETOUCH_SHARED"]) / "data" / "cases" / "files"
    if not folder.is_dir():
        pytest.skip(f"there is no folder {folder}")
    refused = {"decimal_comma.ply": "line 8: '0,410000' has a decimal comma", "tristrips.ply": "triangle strips"}
    target = read_shape(folder / "reference_target.ply").points
    for path in sorted(folder.iterdir()):
        if path.name in refused:
            with pytest.raises(Malformed) as raised:
                read_shape(path)
            assert refused[path.name] in str(raised.value)
            continue
        points = read_shape(path).points / (1000 if path.name == "millimetres.ply" else 1)
        if "finger" not in path.name:
            np.testing.assert_allclose(np.ptp(points, axis=0), np.ptp(target, axis=0), atol=1e-3)


@pytest.mark.parametrize("name", ["none.ply", "folder.ply"])
def test_what_is_no_file_is_not_found(tmp_path: Path, name: str) -> None:
    (tmp_path / "folder.ply").mkdir()
    with pytest.raises(NotFound):
        read_shape(tmp_path / name)


SCENES = {f".{kind}": trimesh.creation.box((0.1, 0.1, 0.1)).export(file_type=kind) for kind in ("glb", "3mf")}


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_no_damage_gets_past_the_readers(tmp_path: Path, data: st.DataObject) -> None:
    """Whatever bytes are flipped or cut, a file is read or refused, never anything else."""
    good = {
        ".ply": faces_file(tmp_path, data.draw(st.booleans())).read_bytes(),
        ".pcd": pcd("ascii", "0 0 0\n1 1 1\n").encode(),
        ".stl": STL.encode(),
        ".obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1//2 2/1 -1\n",
        ".off": b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
        **SCENES,
    }
    suffix = data.draw(st.sampled_from(sorted(good)))
    raw = bytearray(good[suffix])
    for at in data.draw(st.lists(st.integers(0, len(raw) - 1), max_size=4)):
        raw[at] = data.draw(st.integers(0, 255))
    del raw[data.draw(st.integers(0, len(raw))) :]
    try:
        shape = read_shape(written(tmp_path / f"damaged{suffix}", bytes(raw)))
    except PretouchError:
        return
    assert shape.points.shape[1:] == (3,)


def test_the_simulations_own_meshes_are_read(tmp_path: Path) -> None:
    from helpers.made_frame import write_mesh

    mesh: Mesh = MAKERS["box"]()
    write_mesh(tmp_path / "box.obj", mesh)
    read = read_shape(tmp_path / "box.obj")
    assert read.faces is not None
    np.testing.assert_allclose(read.points, mesh.vertices)
    np.testing.assert_array_equal(read.faces, mesh.faces)
