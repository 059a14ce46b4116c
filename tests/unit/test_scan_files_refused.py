"""Files of points that cannot be read are refused for their true cause, with its place and what to do."""

from __future__ import annotations

import gzip
import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import trimesh
from helpers.point_files import MESH_PLY, PLY, ROWS, STL, XYZ, faces_file, glb_of, pcd, written, zip_of
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pretouch_registrar.files import read_shape

from pretouch.errors import InvalidInput, Malformed, NotFound, PretouchError

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
    "a list as long as a float": (
        "a.ply",
        MESH_PLY.replace("list uchar", "list float") + ROWS,
        "line 9: the length of the list vertex_index is of type float",
    ),
    "a viewpoint of two": ("a.pcd", pcd("ascii", "0 0 0\n1 1 1\n", VIEWPOINT="1 2"), "line 9: VIEWPOINT is '1 2'"),
    "a viewpoint of words": ("a.pcd", pcd("ascii", "0 0 0\n1 1 1\n", VIEWPOINT="a b c"), "line 9: VIEWPOINT"),
    "a viewpoint of NaN": ("a.pcd", pcd("ascii", "0 0 0\n1 1 1\n", VIEWPOINT=7 * "nan "), "line 9: VIEWPOINT"),
    "gzip": ("a.ply", gzip.compress(b"ply"), "compressed with gzip"),
    "zip": ("a.obj", b"PK\3\4 and more", "ZIP archive"),
    "UTF-16": ("a.obj", "v 0 0 0".encode("utf-16"), "UTF-16"),
    "Git LFS": ("a.stl", "version https://git-lfs.github.com/spec/v1\n", "Git LFS"),
    "nothing": ("a.ply", "", "is empty"),
    "an OFF of two dimensions": ("a.off", "OFF\n2 0 0\n0 0\n1 1\n", "line 3: it holds 2 numbers"),
    "a glb of 12 bytes": ("a.glb", b"glTF\2\0\0\0\x0c\0\0\0", "a.glb is damaged"),
    "a glb of no document": ("a.glb", glb_of("null"), "a.glb is damaged"),
    "a glb of deep brackets": ("a.glb", glb_of(200_000 * "["), "a.glb is damaged"),
    "a glb whose scene is missing": ("a.glb", glb_of('{"scene": 7, "scenes": []}'), "a.glb is damaged"),
    "a glb of version 1": ("a.glb", glb_of("{}", version=1), "glTF of version 1"),
    "a glb in two files": (
        "a.glb",
        glb_of('{"buffers": [{"uri": "more.bin", "byteLength": 4}]}'),
        "refers to another file, more.bin",
    ),
    "a glb that needs an extension": (
        "a.glb",
        glb_of('{"extensionsRequired": ["KHR_materials_unlit", "EXT_meshopt_compression"]}'),
        "needs the extension EXT_meshopt_compression",
    ),
    "a glb of 10^12 points": (
        "a.glb",
        glb_of('{"accessors": [{"count": 1000000000000}]}'),
        "more than 150000000 values",
    ),
    "a 3mf without a model": ("a.3mf", zip_of("thumbnail.png", b""), "holds no 3D/3dmodel.model"),
    "a 3mf of spaces": ("a.3mf", zip_of("3D/3dmodel.model", b"   "), "a.3mf is damaged"),
    "a 3mf that unpacks to more than fits": (
        "a.3mf",
        zip_of("3D/3dmodel.model", b"", stated_size=700_000_000),
        "unpacks to 700000000 bytes",
    ),
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


@pytest.mark.parametrize("name", ["none.ply", "folder.ply"])
def test_what_is_no_file_is_not_found(tmp_path: Path, name: str) -> None:
    (tmp_path / "folder.ply").mkdir()
    with pytest.raises(NotFound):
        read_shape(tmp_path / name)


def test_no_warning_of_a_library_reaches_the_terminal(tmp_path: Path) -> None:
    """In a process of its own, since pytest takes warnings and log lines for itself."""
    model = '<model><resources/><build><item objectid="5"/></build></model>'
    written(tmp_path / "a.3mf", zip_of("3D/3dmodel.model", model.encode()))
    box = trimesh.Scene()
    box.add_geometry(trimesh.creation.box(), transform=np.diag([1e308, 1e308, 1e308, 1.0]))
    written(tmp_path / "a.glb", box.export(file_type="glb"))
    reads = """
import pathlib, sys
from pretouch.errors import PretouchError
from pretouch_registrar.files import read_shape
for name in ("a.3mf", "a.glb"):
    try:
        read_shape(pathlib.Path(name))
    except PretouchError as error:
        print(error)
"""
    done = subprocess.run([sys.executable, "-c", reads], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stderr == ""
    assert done.stdout == "a.3mf holds no triangles.\na.glb holds coordinates beyond 1e+06 m.\n"


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
