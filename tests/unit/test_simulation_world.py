"""Rays in the simulated world agree with the geometry; invalid meshes and world files are refused with a reason."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_simulation.mesh import Mesh, load_mesh
from pretouch_simulation.objects import MAKERS, bowl, box, can, mug
from pretouch_simulation.world import NOTHING, TABLE, Body, World

from pretouch.errors import InvalidInput, Malformed, NotFound
from pretouch.geometry import Plane, Pose

FLOOR = Plane(np.array([0.0, 0.0, 1.0]), 0.0)


def world_of(mesh: Mesh, base_T_mesh: Pose | None = None) -> World:
    return World([Body(mesh, base_T_mesh or Pose.identity())], FLOOR)


def test_a_ray_from_above_meets_the_box_or_the_table() -> None:
    world = world_of(box(0.1, 0.06, 0.14))
    down = np.tile([0.0, 0.0, -1.0], (4, 1))
    origins = np.array([[0, 0, 0.3], [0.049, -0.029, 0.3], [0.051, 0, 0.3], [0, 0.031, 0.3]])
    hits = world.trace(origins, down)
    np.testing.assert_allclose(hits.distances, [0.16, 0.16, 0.3, 0.3], atol=1e-6)
    assert hits.bodies.tolist() == [0, 0, TABLE, TABLE]
    np.testing.assert_allclose(hits.normals, np.tile([0, 0, 1.0], (4, 1)), atol=1e-6)


def test_a_ray_away_from_everything_meets_nothing() -> None:
    hits = world_of(box()).trace([[0.0, 0.0, 0.3], [0.0, 0.0, 0.3]], [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    assert np.isinf(hits.distances).all()
    assert (hits.bodies == NOTHING).all()
    assert (hits.normals == 0).all()


@settings(max_examples=25, deadline=None)
@given(st.floats(-1, 1), st.floats(-0.5, 0.5), st.floats(0.05, 1.5), st.floats(0.2, 0.9))
def test_distances_to_a_tilted_table_are_those_of_the_plane(x: float, tilt: float, height: float, slope: float) -> None:
    normal = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    world = World([], Plane(normal, 0.1))
    origin = normal * (0.1 + height) + np.array([0.0, x, 0.0])
    direction = np.array([0.0, slope, -1.0])
    distance = world.cast([origin], [direction])[0]
    assert (origin + distance * direction) @ normal == pytest.approx(0.1, abs=1e-9)


def test_moving_a_body_moves_what_rays_meet() -> None:
    pose = Pose.from_rotation_vector([0.0, 0.0, 0.7], [0.2, -0.1, 0.05])
    origins, directions = np.array([[0.0, 0.01, 0.5]]), np.array([[0.02, 0.0, -1.0]])
    still = world_of(can()).cast(origins, directions)
    moved = world_of(can(), pose).cast(pose.apply(origins), pose.rotate(directions))
    np.testing.assert_allclose(moved, still, atol=1e-6)


def test_a_saved_world_is_the_same_world(tmp_path: Path) -> None:
    world = World(
        [Body(mug(), Pose.from_rotation_vector([0, 0, 1.0], [0.1, 0, 0])), Body(box(), Pose.identity())], FLOOR
    )
    world.save(tmp_path / "world.npz")
    again = World.load(tmp_path / "world.npz")
    rng = np.random.default_rng(0)
    origins = rng.uniform([-0.1, -0.1, 0.2], [0.2, 0.2, 0.5], (200, 3))
    directions = np.tile([0.1, 0.05, -1.0], (200, 1))
    np.testing.assert_array_equal(again.cast(origins, directions), world.cast(origins, directions))


@pytest.mark.parametrize("content", [b"", b"no archive at all", b"PK\x03\x04 cut short"])
def test_a_file_that_is_no_world_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "world.npz"
    path.write_bytes(content)
    with pytest.raises(InvalidInput, match="not a world"):
        World.load(path)
    with pytest.raises(NotFound):
        World.load(tmp_path / "missing.npz")


@pytest.mark.parametrize("name", MAKERS)
def test_made_objects_stand_on_the_table_with_their_faces_outwards(name: str) -> None:
    mesh = MAKERS[name]()
    assert mesh.vertices[:, 2].min() == pytest.approx(0.0, abs=1e-9)
    assert 0.03 < mesh.extents.max() < 0.3
    assert mesh.watertight
    assert mesh.volume() > 0


def test_made_objects_have_their_volume() -> None:
    assert box(0.1, 0.2, 0.3).volume() == pytest.approx(0.006)
    assert can(0.03, 0.1).volume() == pytest.approx(np.pi * 0.03**2 * 0.1, rel=0.03)


def test_a_bowl_is_hollow() -> None:
    world = world_of(bowl(0.08, 0.06, 0.004))
    assert world.cast([[0, 0, 0.5]], [[0, 0, -1.0]])[0] == pytest.approx(0.496, abs=1e-6)
    assert world.cast([[0.078, 0, 0.5]], [[0, 0, -1.0]])[0] == pytest.approx(0.44, abs=0.002)


def write_mesh(path: Path, mesh: Mesh) -> None:
    if path.suffix == ".obj":
        lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices] + [
            f"f {a + 1} {b + 1} {c + 1}" for a, b, c in mesh.faces
        ]
    elif path.suffix == ".ply":
        lines = ["ply", "format ascii 1.0", f"element vertex {len(mesh.vertices)}"]
        lines += [f"property float {axis}" for axis in "xyz"]
        lines += [f"element face {len(mesh.faces)}", "property list uchar int vertex_indices", "end_header"]
        lines += [f"{x} {y} {z}" for x, y, z in mesh.vertices] + [f"3 {a} {b} {c}" for a, b, c in mesh.faces]
    else:
        lines = ["solid box"]
        for face in mesh.faces:
            corners = [f"vertex {x} {y} {z}" for x, y, z in mesh.vertices[face]]
            lines += ["facet normal 0 0 0", "outer loop", *corners, "endloop", "endfacet"]
        lines.append("endsolid box")
    path.write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl"])
def test_meshes_are_read_from_files(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"box{suffix}"
    write_mesh(path, box(0.1, 0.06, 0.14))
    read = load_mesh(path)
    np.testing.assert_allclose(read.extents, [0.1, 0.06, 0.14], atol=1e-6)
    assert read.watertight


def test_a_bad_mesh_file_says_what_is_wrong(tmp_path: Path) -> None:
    with pytest.raises(NotFound, match="There is no file"):
        load_mesh(tmp_path / "missing.ply")
    (tmp_path / "notes.txt").write_text("hello")
    with pytest.raises(InvalidInput, match=r"notes\.txt"):
        load_mesh(tmp_path / "notes.txt")
    (tmp_path / "broken.ply").write_bytes(b"ply\nformat ascii 1.0\nelement vertex 3\nend_header\n1 2\n")
    with pytest.raises(Malformed, match="have no x, y, z"):
        load_mesh(tmp_path / "broken.ply")
    (tmp_path / "cloud.obj").write_text("v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\n")
    with pytest.raises(Malformed, match="no triangles"):
        load_mesh(tmp_path / "cloud.obj")
    (tmp_path / "millimetres.obj").write_text("v 0 0 0\nv 100 0 0\nv 0 100 0\nf 1 2 3\n")
    with pytest.raises(InvalidInput, match="100 m long, as if it were in millimetres"):
        load_mesh(tmp_path / "millimetres.obj")


def test_a_mesh_whose_faces_name_no_vertex_is_refused() -> None:
    with pytest.raises(InvalidInput, match="does not exist"):
        Mesh(np.zeros((3, 3)), np.array([[0, 1, 3]]))
    with pytest.raises(InvalidInput, match="no triangles"):
        Mesh(np.zeros((3, 3)), np.zeros((0, 3), dtype=int))
