"""Neighbours stand near the object without touching it, leave it visible, and repeat to the bit."""

from pathlib import Path

import numpy as np
import pytest
from helpers.made_frame import write_mesh
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_simulation.clutter import CLEARANCE, GAP, NEIGHBOURS, VISIBLE, gap_between
from pretouch_simulation.depth_cameras import CameraModel
from pretouch_simulation.evaluation_tasks import MeshTask
from pretouch_simulation.objects import MAKERS, can
from pretouch_simulation.protocol import Case
from pretouch_simulation.world import Body

from pretouch.errors import InvalidInput
from pretouch.geometry import Pose

VIEWS = range(4)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("meshes")
    for name, make in MAKERS.items():
        write_mesh(folder / f"{name}.obj", make())
    (folder / "broken.obj").write_text("v 0 0 0\n")
    return sorted(folder.iterdir())


def case_among(files: list[Path], name: str, view: int, seed: int = 0) -> Case:
    others = tuple(path for path in files if path.stem != name)
    return MeshTask(files[0].parent / f"{name}.obj", view, others).case(seed, CameraModel.KINECT)


@pytest.fixture(scope="module")
def cases(files: list[Path]) -> list[Case]:
    return [case_among(files, name, view) for name in ("mug", "box") for view in VIEWS]


def test_two_runs_are_equal_to_the_bit_and_seeds_differ(cases: list[Case], files: list[Path]) -> None:
    again, other = (case_among(files, "mug", 0, seed) for seed in (0, 1))
    np.testing.assert_array_equal(again.depth.metres, cases[0].depth.metres)
    np.testing.assert_array_equal(again.truth.matrix, cases[0].truth.matrix)
    for one, two in zip(again.world.bodies, cases[0].world.bodies, strict=True):
        np.testing.assert_array_equal(one.base_T_mesh.matrix, two.base_T_mesh.matrix)
    assert not np.array_equal(other.depth.metres, again.depth.metres)


def test_two_to_five_stand_near_and_apart(cases: list[Case]) -> None:
    for case in cases:
        target, *others = case.world.bodies
        assert NEIGHBOURS[0] <= len(others) <= NEIGHBOURS[1]
        for k, body in enumerate(others):
            assert GAP[0] - 1e-3 <= gap_between(target, body) <= GAP[1] + 1e-3
            assert all(gap_between(body, other) >= CLEARANCE for other in others[:k])
    assert len({len(case.world.bodies) for case in cases}) > 1


def test_they_rest_on_the_table_and_some_are_taller(cases: list[Case]) -> None:
    bodies = [(case.world.bodies[0], body) for case in cases for body in case.world.bodies[1:]]
    for _, body in bodies:
        heights = body.base_T_mesh.apply(body.mesh.vertices)[:, 2]
        assert heights.min() == pytest.approx(0.0, abs=1e-9)
    assert any(body.mesh.extents[2] > target.mesh.extents[2] for target, body in bodies)


def test_object_view_and_camera_are_those_of_the_object_alone(cases: list[Case], files: list[Path]) -> None:
    for view in VIEWS:
        alone = MeshTask(files[0].parent / "mug.obj", view).case(0, CameraModel.KINECT)
        among = cases[view]
        camera, same = (case.truth @ case.base_T_camera for case in (alone, among))
        np.testing.assert_allclose(camera.matrix, same.matrix, atol=1e-12)
        np.testing.assert_array_equal(
            alone.world.bodies[0].base_T_mesh.matrix, among.world.bodies[0].base_T_mesh.matrix
        )
        assert among.scored.sum() > (VISIBLE - 0.1) * alone.scored.sum()
        assert not np.array_equal(alone.depth.metres, among.depth.metres)


def test_all_moves_as_one(cases: list[Case]) -> None:
    case = cases[0]
    points = case.camera.back_project_image(case.depth.metres)[case.depth.metres > 0]
    heights = (case.truth @ case.base_T_camera).apply(points)[:, 2]
    assert np.abs(np.median(heights)) < 0.003


@settings(max_examples=30, deadline=None)
@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(-3.0, 3.0))
def test_gaps_of_cans_are_those_of_circles(x: float, y: float, turn: float) -> None:
    radius = 0.03
    one = Body(can(radius, 0.1), Pose.identity())
    two = Body(can(radius, 0.1), Pose.from_rotation_vector([0, 0, turn], [x, y, 0]))
    assert gap_between(one, two) == pytest.approx(np.hypot(x, y) - 2 * radius, abs=0.001)


def test_too_few_things_are_refused(files: list[Path]) -> None:
    mug, bottle = (files[0].parent / f"{name}.obj" for name in ("mug", "bottle"))
    with pytest.raises(InvalidInput, match="Too few things fit"):
        MeshTask(mug, 0, (bottle,)).case(0, CameraModel.KINECT)
