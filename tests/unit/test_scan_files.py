"""Point files of other tools: read exactly, or refused with a remedy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pretouch_registrar.files import read_shape
from pretouch_registrar.files.shape import Shape
from pretouch_simulation.mesh import Mesh
from pretouch_simulation.objects import MAKERS
from pretouch_simulation.open3d_loader import open3d

from pretouch.errors import InvalidInput, Malformed, NotFound, PretouchError
from pretouch.geometry import Array

POINTS = np.random.default_rng(0).uniform(-1, 1, (300, 3)).astype(np.float32).astype(np.float64)
MUG = MAKERS["mug"]()
PLY = "ply\nformat {} 1.0\ncomment made by hand\nelement vertex 3\n{}end_header\n"
XYZ = "property float x\nproperty float y\nproperty float z\n"


def written(path: Path, data: bytes | str) -> Path:
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    return path


def by_open3d(path: Path, points: Array, **options: Any) -> Shape:
    o3d = open3d()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.colors = o3d.utility.Vector3dVector(np.full(points.shape, 0.5))
    assert o3d.io.write_point_cloud(str(path), cloud, **options)
    return read_shape(path)


@pytest.mark.parametrize("suffix", [".ply", ".pcd"])
@pytest.mark.parametrize("options", [{"write_ascii": True}, {}, {"compressed": True}], ids=str)
def test_clouds_of_another_library_are_read(tmp_path: Path, suffix: str, options: dict[str, bool]) -> None:
    read = by_open3d(tmp_path / f"cloud{suffix}", POINTS, **options)
    np.testing.assert_allclose(read.points, POINTS, atol=1e-6)
    assert read.faces is None
    assert read.viewpoint is None


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(1, 3000), st.integers(1, 500), st.integers(0, 99))
def test_compressed_clouds_of_any_likeness_are_read(tmp_path: Path, count: int, period: int, seed: int) -> None:
    few = np.random.default_rng(seed).uniform(-1, 1, (period, 3)).astype(np.float32)
    points = few[np.arange(count) % period].astype(np.float64)
    read = by_open3d(tmp_path / "cloud.pcd", points, compressed=True)
    np.testing.assert_array_equal(read.points, points)


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl"])
@pytest.mark.parametrize("ascii_", [True, False])
def test_meshes_of_another_library_are_read(tmp_path: Path, suffix: str, ascii_: bool) -> None:
    o3d = open3d()
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(MUG.vertices.copy()), o3d.utility.Vector3iVector(MUG.faces.astype(np.int32))
    )
    mesh.compute_triangle_normals()
    path = tmp_path / f"mesh{suffix}"
    assert o3d.io.write_triangle_mesh(str(path), mesh, write_ascii=ascii_ and suffix == ".ply")
    read = read_shape(path)
    assert read.faces is not None
    np.testing.assert_allclose(read.points[read.faces], MUG.vertices[MUG.faces], atol=2e-6)


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
    assert read.left_out == 1


STL = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid\n"


def test_an_ascii_stl_is_read(tmp_path: Path) -> None:
    read = read_shape(written(tmp_path / "a.stl", STL))
    np.testing.assert_array_equal(read.points, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])


ROWS = "0 0 0\n1 0 0\n0 1 0\n"
BAD: dict[str, tuple[str, bytes | str, type[PretouchError]]] = {
    "another kind": ("a.xyz", "0 0 0", InvalidInput),
    "no suffix": ("a", "", InvalidInput),
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
    "an empty obj": ("a.obj", "", InvalidInput),
    "an stl cut short": ("a.stl", STL.replace("vertex 1 0 0\n", ""), Malformed),
    "an stl of words": ("a.stl", STL.replace("1", "one"), Malformed),
    "an empty stl": ("a.stl", "", Malformed),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_a_bad_file_is_refused_with_what_to_do(tmp_path: Path, case: str) -> None:
    name, data, kind = BAD[case]
    with pytest.raises(PretouchError) as raised:
        read_shape(written(tmp_path / name, data))
    assert type(raised.value) is kind
    assert raised.value.remedy


def test_a_file_that_is_not_there_is_not_found(tmp_path: Path) -> None:
    with pytest.raises(NotFound, match="cannot be read"):
        read_shape(tmp_path / "none.ply")


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_no_damage_gets_past_the_readers(tmp_path: Path, data: st.DataObject) -> None:
    """Whatever bytes are flipped or cut, a file is read or refused, never anything else."""
    good = {
        ".ply": faces_file(tmp_path, data.draw(st.booleans())).read_bytes(),
        ".pcd": pcd("ascii", "0 0 0\n1 1 1\n").encode(),
        ".stl": STL.encode(),
        ".obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1//2 2/1 -1\n",
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
