"""The evaluation protocol applies the stated offset, repeats to the bit, and scores as documented."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_simulation import protocol
from pretouch_simulation.mesh import Mesh
from pretouch_simulation.objects import MAKERS, bottle, box, drill
from pretouch_simulation.protocol import Case, draw_hidden_offset, generator, make_case
from pretouch_simulation.stable_pose import stand

from pretouch.errors import InvalidInput
from pretouch.estimate import Estimate
from pretouch.geometry import Pose, vector_from_rotation
from pretouch.prior import Prior


@pytest.fixture(scope="module")
def case() -> Case:
    return make_case("drill", drill(), 3, seed=1)


def test_two_runs_of_a_view_are_equal_to_the_bit(case: Case) -> None:
    again = make_case("drill", drill(), 3, seed=1)
    np.testing.assert_array_equal(case.depth.metres, again.depth.metres)
    np.testing.assert_array_equal(case.base_T_camera.matrix, again.base_T_camera.matrix)
    np.testing.assert_array_equal(case.truth.matrix, again.truth.matrix)


@pytest.mark.parametrize(("name", "view", "seed"), [("drill", 4, 1), ("mug", 3, 1), ("drill", 3, 2)])
def test_name_view_and_seed_each_give_another_view(case: Case, name: str, view: int, seed: int) -> None:
    assert not np.array_equal(case.truth.matrix, make_case(name, drill(), view, seed).truth.matrix)


def test_seeds_do_not_depend_on_the_process() -> None:
    assert generator("view", 0, "mug", 1).integers(2**32) == 3621183399


def test_the_truth_moves_what_the_camera_shows_onto_the_true_object(case: Case) -> None:
    assert case.error(case.truth) == 0.0
    body = case.world.bodies[0]
    corrected = case.truth.apply(case.cloud)
    low, high = (f(body.base_T_mesh.apply(body.mesh.vertices), axis=0) for f in (np.min, np.max))
    inside = ((corrected > low - 0.01) & (corrected < high + 0.01)).all(axis=1)
    assert inside.mean() > 0.95
    assert corrected[:, 2].min() > -0.02
    uncorrected = case.cloud.mean(axis=0) - corrected.mean(axis=0)
    assert np.abs(uncorrected).max() > 0.003


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32))
def test_the_offset_is_a_turn_about_the_centroid_as_the_camera_puts_it_and_a_shift(seed: int) -> None:
    true_cloud = np.random.default_rng(0).normal(0.3, 0.05, (200, 3))
    truth = draw_hidden_offset(true_cloud, np.random.default_rng(seed))
    given_cloud = truth.inverse().apply(true_cloud)
    centroid = given_cloud.mean(axis=0)
    shift = truth.apply(centroid) - centroid
    assert np.abs(shift).max() <= 0.02 + 1e-12
    assert np.linalg.norm(vector_from_rotation(truth.rotation)) <= np.sqrt(3) * np.radians(5) + 0.01


def test_offsets_fill_their_box() -> None:
    rng = np.random.default_rng(0)
    point = np.array([[0.5, 0.1, 0.2]])
    offsets = [draw_hidden_offset(point, rng) for _ in range(400)]
    shifts = np.array([(point - offset.inverse().apply(point))[0] for offset in offsets])
    turns = np.array([vector_from_rotation(offset.rotation) for offset in offsets])
    assert shifts.std(axis=0) == pytest.approx(np.full(3, 0.02 / np.sqrt(3)), rel=0.1)
    assert turns.std(axis=0) == pytest.approx(np.full(3, np.radians(5) / np.sqrt(3)), rel=0.1)


def test_the_camera_stands_where_the_protocol_says(case: Case) -> None:
    camera = case.truth @ case.base_T_camera
    way = camera.rotation[:, 2]
    middle = protocol.PLACE + np.array([0, 0, case.world.bodies[0].mesh.extents[2] / 2])
    distance = np.linalg.norm(camera.translation - middle)
    assert 0.8 <= distance <= 1.0
    assert np.radians(40) <= np.arcsin(-way[2]) <= np.radians(50)
    np.testing.assert_allclose(camera.translation + distance * way, middle, atol=1e-9)
    assert case.depth.metres.shape == (480, 640)


def estimate_of(pose: Pose, case: Case, scale: float) -> Estimate:
    return Estimate(pose, case.cloud.mean(axis=0), Prior().covariance * scale, 0.01, 0.02)


def test_coverage_asks_whether_the_truth_is_in_the_stated_region(case: Case) -> None:
    assert case.is_covered_by(estimate_of(case.truth, case, 1e-9))
    assert not case.is_covered_by(estimate_of(Pose.identity(), case, 1e-3))
    assert case.is_covered_by(estimate_of(Pose.identity(), case, 1.0))


@pytest.mark.parametrize("name", MAKERS)
def test_an_object_that_stands_is_left_standing(name: str) -> None:
    mesh = MAKERS[name]()
    np.testing.assert_allclose(stand(mesh).vertices, mesh.resting().vertices, atol=1e-12)


def test_an_object_that_would_fall_is_put_on_its_largest_face() -> None:
    tipped = box(0.02, 0.1, 0.2).moved(Pose.from_rotation_vector([0.6, 0.4, 0.0], [0, 0, 0]))
    assert stand(tipped).extents[2] == pytest.approx(0.02, abs=1e-6)
    tilted = bottle().moved(Pose.from_rotation_vector([0.7, 0.0, 0.0], [0, 0, 0]))
    np.testing.assert_allclose(stand(tilted).extents, bottle().extents, atol=1e-4)


def test_a_flat_mesh_is_refused() -> None:
    with pytest.raises(InvalidInput, match="no volume"):
        stand(Mesh(np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]]), np.array([[0, 1, 2]])))
