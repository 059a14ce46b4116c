"""Point files of other tools are read exactly."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from helpers.point_files import (
    MESH_PLY,
    PLY,
    ROWS,
    STL,
    XYZ,
    binary_ply,
    compressed_pcd,
    faces_file,
    pcd,
    text_rows,
    written,
)
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pretouch_registrar.files import read_shape
from pretouch_simulation.mesh import Mesh
from pretouch_simulation.objects import MAKERS

from pretouch.errors import Malformed

POINTS = np.random.default_rng(0).uniform(-1, 1, (300, 3)).astype(np.float32).astype(np.float64)
MUG = MAKERS["mug"]()


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


@pytest.mark.parametrize("binary", [True, False])
def test_polygons_become_triangles(tmp_path: Path, binary: bool) -> None:
    read = read_shape(faces_file(tmp_path, binary))
    np.testing.assert_array_equal(read.points, np.arange(15.0).reshape(5, 3))
    assert read.faces is not None
    np.testing.assert_array_equal(read.faces, [[0, 1, 2], [0, 1, 2], [0, 2, 3], [0, 1, 2], [0, 2, 3], [0, 3, 4]])


def test_a_pcd_says_where_it_was_seen_from_and_which_points_are_none(tmp_path: Path) -> None:
    changes = {"FIELDS": "rgb normal x y z", "SIZE": "4 4 4 4 4", "TYPE": "U F F F F", "COUNT": "1 3 1 1 1"}
    body = "7 0 0 1 0.1 0.2 0.3\n7 0 0 1 nan nan nan\n"
    read = read_shape(written(tmp_path / "a.pcd", pcd("ascii", body, **changes, VIEWPOINT="0.5 0 1 1 0 0 0")))
    np.testing.assert_array_equal(read.points, [[0.1, 0.2, 0.3]])
    np.testing.assert_array_equal(read.viewpoint, [0.5, 0, 1])
    assert read.remarks == ("points without coordinates left out: 1.",)


def test_an_ascii_stl_is_read(tmp_path: Path) -> None:
    read = read_shape(written(tmp_path / "a.stl", STL))
    np.testing.assert_array_equal(read.points, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])


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


@pytest.mark.filterwarnings("error")
def test_a_signalling_nan_is_no_data_without_a_warning(tmp_path: Path) -> None:
    rows = np.array([[0x7FA00000] * 3, [0, 0, 0]], dtype="<u4").tobytes()
    read = read_shape(written(tmp_path / "a.pcd", pcd("binary", "").encode() + rows))
    np.testing.assert_array_equal(read.points, [[0, 0, 0]])


def test_the_shared_files_of_other_tools_are_read_or_refused_for_the_true_cause() -> None:
    beside = Path(__file__).resolve().parents[3] / "shared"
    folder = Path(os.environ.get("PRETOUCH_SHARED", beside)) / "data" / "cases" / "files"
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


def test_the_simulations_own_meshes_are_read(tmp_path: Path) -> None:
    from helpers.made_frame import write_mesh

    mesh: Mesh = MAKERS["box"]()
    write_mesh(tmp_path / "box.obj", mesh)
    read = read_shape(tmp_path / "box.obj")
    assert read.faces is not None
    np.testing.assert_allclose(read.points, mesh.vertices)
    np.testing.assert_array_equal(read.faces, mesh.faces)
