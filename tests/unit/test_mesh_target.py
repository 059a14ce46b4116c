"""A mesh as the target: rendered exactly, refused if invalid, and registered at least as well as a view."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.mesh_cases import blind_scans, mesh_target_of
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_registrar import mesh_scene as module
from pretouch_registrar.mesh_scene import mesh_scene
from pretouch_registrar.registration import Registrar, Settings
from pretouch_simulation.objects import MAKERS
from pretouch_simulation.protocol import TABLE, make_case
from pretouch_simulation.world import Body, World

from pretouch.errors import InvalidInput, Malformed, PretouchError, TooLarge
from pretouch.geometry import Plane, Pose
from pretouch.mesh_target import MAX_FACES, MeshTarget
from pretouch.scene import Scene
from pretouch.wire.common import mesh_from_proto, mesh_to_proto

REGISTRAR = Registrar()

BOX = MAKERS["box"]()


def target(**changes: Any) -> MeshTarget:
    given_ = {"vertices": BOX.vertices, "faces": BOX.faces, "base_T_object": Pose.identity(), "table": TABLE}
    return MeshTarget(**(given_ | changes))


@settings(max_examples=12, deadline=None)
@given(
    st.sampled_from(sorted(MAKERS)),
    st.tuples(*[st.floats(-0.2, 0.2)] * 2, st.floats(-3, 3)),
    st.tuples(*[st.floats(-0.5, 0.5)] * 2, st.floats(0, 0.3)),
)
def test_each_pixel_is_where_a_ray_meets_the_mesh_or_the_table(
    name: str, turn: tuple[float, float, float], place: tuple[float, float, float]
) -> None:
    mesh, pose = MAKERS[name](), Pose.from_rotation_vector(turn, place)
    table = Plane(np.array([0.0, 0.6, 0.8]), -0.4)
    scene = mesh_scene(MeshTarget(mesh.vertices, mesh.faces, pose, table))
    pixels = np.random.default_rng(0).integers(0, scene.depth.metres.shape[::-1], (400, 2))
    rays = scene.base_T_camera.rotate(scene.camera.back_project(pixels, np.ones(len(pixels))))
    starts = np.broadcast_to(scene.base_T_camera.translation, rays.shape) + 2.5 * rays
    hits = World([Body(mesh, pose)], table).trace(starts, rays)
    drawn = scene.depth.metres[pixels[:, 1], pixels[:, 0]]
    off = np.abs(drawn - (hits.distances + 2.5)) > 1e-4
    assert off.mean() < 0.03  # rays through an edge may go either way
    assert (scene.mask[pixels[:, 1], pixels[:, 0]] == (hits.bodies == 0))[~off].mean() > 0.97


def test_the_table_surrounds_the_object() -> None:
    scene = mesh_scene(target())
    heights = scene.table.height(scene.organised)
    np.testing.assert_allclose(heights[~scene.mask], 0.0, atol=1e-6)
    assert scene.mask[[0, -1]].sum() == scene.mask[:, [0, -1]].sum() == 0
    np.testing.assert_allclose(heights[scene.mask], 0.14, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "kind", "said"),
    [
        ({"faces": np.zeros((0, 3), dtype=int)}, InvalidInput, "shape [0, 3]"),
        ({"faces": BOX.faces[:, :2]}, InvalidInput, "shape [12, 2]"),
        ({"faces": BOX.faces.astype(float)}, InvalidInput, "float64"),
        ({"faces": BOX.faces + 1}, InvalidInput, "names vertex 8; there are 8"),
        ({"faces": BOX.faces - 1}, InvalidInput, "names vertex -1"),
        ({"vertices": np.zeros((0, 3))}, InvalidInput, "there are 0"),
        ({"vertices": np.where(BOX.vertices > 0.1, np.nan, BOX.vertices)}, Malformed, "NaN"),
        ({"vertices": np.where(BOX.vertices > 0.1, np.inf, BOX.vertices)}, Malformed, "infinity"),
        ({"vertices": 1000 * BOX.vertices}, InvalidInput, "140 m long"),
        ({"vertices": 0 * BOX.vertices}, InvalidInput, "no area"),
        ({"vertices": BOX.vertices * [1, 0, 0]}, InvalidInput, "no area"),
        ({"vertices": 0.001 * BOX.vertices}, InvalidInput, "no area|covers|area"),
        ({"faces": np.zeros((MAX_FACES + 1, 3), dtype=np.uint8)}, TooLarge, "the limit is 1000000 faces"),
        ({"vertices": BOX.vertices * [1, 0, 1]}, InvalidInput, "covers 0 pixels"),
        ({"base_T_object": Pose.of(np.eye(3), [0, 0, -0.2])}, InvalidInput, "below the table"),
    ],
)
def test_a_bad_mesh_is_refused_with_what_to_do(change: dict[str, Any], kind: type[PretouchError], said: str) -> None:
    with pytest.raises(kind) as raised:
        mesh_scene(target(**change))
    assert type(raised.value) is kind
    assert any(word in raised.value.detail for word in said.split("|"))
    assert raised.value.remedy


def test_triangles_that_cover_each_other_endlessly_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_MAX_VISITS", 10_000)
    with pytest.raises(InvalidInput, match="cover each other"):
        mesh_scene(target(faces=np.tile(BOX.faces, (100, 1))))


def test_a_mesh_crosses_the_wire() -> None:
    given_ = target(base_T_object=Pose.from_rotation_vector([0.1, 0.2, 0.3], [0.4, 0.5, 0.6]))
    back = mesh_from_proto(mesh_to_proto(given_))
    np.testing.assert_allclose(back.vertices, given_.vertices, atol=1e-7)
    np.testing.assert_array_equal(back.faces, given_.faces)
    assert back.base_T_object.is_close(given_.base_T_object)
    assert back.table.offset == given_.table.offset


def test_a_known_shape_is_matched_at_least_as_well_as_what_a_camera_saw() -> None:
    errors = []
    for name in ("box", "can", "bottle", "drill"):
        case = make_case(name, MAKERS[name](), 0)
        mesh = mesh_target_of(case)
        seen = Scene(case.depth, case.camera, case.base_T_camera, case.mask, mesh.table).cropped(0.1)[0]
        scans = blind_scans(case)
        by_camera, by_mesh = (REGISTRAR.register(scene, scans, Settings()) for scene in (seen, mesh_scene(mesh)))
        errors.append([case.error(answer.base_T_correction) for answer in (by_camera, by_mesh)])
        assert by_mesh.expected_error < 0.008
    camera, known = np.mean(errors, axis=0)
    assert known <= camera
    assert known < 0.004
