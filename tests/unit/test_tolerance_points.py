"""Where the error counts: `tolerance.at` changes what is stated of an answer, and never the answer."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from helpers.loop_fakes import FormulaRegistrar, RandomDetector, asked, opened
from helpers.scenes import Box, View, World
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_orchestrator.perception.object_symmetry import check_symmetry
from pretouch_orchestrator.perception.tolerance_check import check_points
from pretouch_orchestrator.sessions.loop import Loop
from pretouch_registrar.observability import find_weak_directions
from pretouch_simulation.objects import MAKERS
from pretouch_simulation.protocol import Case, make_case

from pretouch.errors import InvalidInput, Malformed
from pretouch.estimate import Estimate, from_prior, point_error
from pretouch.geometry import Array, Pose
from pretouch.prior import Prior
from pretouch.scene import Scene
from pretouch.session import SessionRequest, State, Tolerance
from pretouch.wire.json import request_from_json, request_to_json

UP = np.array([0.0, 0.0, 1.0])
VIEW = View()
WORLD = World((Box.standing((0.08, 0.06, 0.05)),))
SCENE = WORLD.scene(VIEW)
REQUEST = SessionRequest(VIEW.camera, VIEW.base_T_camera)


@pytest.mark.parametrize("at", [np.zeros((0, 3)), np.zeros((65, 3)), np.zeros(3), np.zeros((2, 2))])
def test_too_few_points_too_many_and_other_shapes_are_refused(at: Array) -> None:
    with pytest.raises(InvalidInput, match=r"tolerance\.at has"):
        Tolerance(at=at)


def test_points_that_are_not_finite_are_refused() -> None:
    with pytest.raises(Malformed, match=r"tolerance\.at"):
        Tolerance(at=np.full((1, 3), np.nan))


@pytest.mark.parametrize("at", [None, [], [[0.0, 0.0]], [0.0, 0.0, 0.0], "axis", [[0.0, 0.0, None]]])
def test_other_json_than_points_is_refused(at: object) -> None:
    document = request_to_json(REQUEST)
    assert "at" not in document["tolerance"]
    document["tolerance"]["at"] = at
    with pytest.raises(InvalidInput, match=r"tolerance\.at"):
        request_from_json(document)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 64))
def test_the_expected_error_is_that_of_drawn_truths_at_the_points(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    points, centroid = rng.normal(0, 0.05, (count, 3)), rng.normal(0, 0.02, 3)
    root = rng.normal(0, 1, (6, 6)) * np.repeat([0.01, 0.002], 3)[:, None]
    draws = rng.normal(size=(4000, 6)) @ root.T
    moved = np.cross(draws[:, None, :3], points - centroid) + draws[:, None, 3:]
    truly = np.linalg.norm(moved, axis=2).mean(axis=1)
    expected, (quantile,) = point_error(root @ root.T, points, centroid)
    assert expected == pytest.approx(truly.mean(), rel=0.1)
    assert quantile == pytest.approx(np.quantile(truly, 0.95), rel=0.15)


def test_a_turn_about_the_points_does_not_count() -> None:
    prior = Prior(1e-4, 0.1)
    loop = Loop(RandomDetector(), FormulaRegistrar())
    whole = opened(loop, asked(prior=prior))
    assert whole.state is State.AWAITING_SCAN
    middle = whole.scene.centroid[None]
    record = opened(loop, asked(prior=prior, tolerance=Tolerance(at=middle)))
    assert record.state is State.CONVERGED
    assert record.estimate.expected_error == point_error(prior.covariance, middle, middle[0])[0]
    np.testing.assert_array_equal(record.estimate.covariance, whole.estimate.covariance)


def test_another_confidence_is_that_at_the_points() -> None:
    prior = Prior(0.001, 0.1)
    loop = Loop(RandomDetector(), FormulaRegistrar(gain=1e-9))
    at = opened(loop, asked(prior=prior)).scene.centroid[None]
    _, (limit,) = point_error(prior.covariance, at, at[0], (0.6,))
    for factor, state in ((1.001, State.CONVERGED), (0.999, State.AWAITING_SCAN)):
        tolerance = Tolerance(float(limit * factor), 0.6, at)
        assert opened(loop, asked(prior=prior, tolerance=tolerance)).state is state


def weak(at: Array | None) -> tuple[str, bool]:
    """Of a cloud whose turn about the vertical through its mean is free."""
    cloud = np.random.default_rng(0).uniform(-0.04, 0.04, (400, 3))
    covariance = np.diag([1e-8, 1e-8, 0.1**2, 1e-8, 1e-8, 1e-8])
    moved = None if at is None else cloud.mean(axis=0) + at
    (found,) = find_weak_directions(covariance, cloud, UP, moved)
    return found.text, found.matters


def test_a_weak_direction_says_whether_it_matters_for_the_points() -> None:
    text, matters = weak(None)
    assert matters
    assert "points" not in text
    assert weak(np.array([[0.0, 0.0, -0.03], [0.0, 0.0, 0.03]])) == (
        f"{text}; it moves the points where the error counts by 0.0 mm",
        False,
    )
    assert weak(np.array([[0.1, 0.0, 0.0]])) == (f"{text}; it moves the points where the error counts by 10.0 mm", True)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(0, len(SCENE.cloud) - 1), min_size=1, max_size=64), st.floats(-0.05, 0.05))
def test_points_at_the_object_are_not_odd(chosen: list[int], away: float) -> None:
    at = SCENE.cloud[chosen] + np.array([0.0, 0.0, away])
    assert check_points(replace(REQUEST, tolerance=Tolerance(at=at)), SCENE) == []


def told(at: Array) -> str:
    """What a client is told of such points."""
    object_pose = Pose.from_rotation_vector([0.0, 0.0, 1.0], [0.0, 0.0, 0.0])
    request = replace(REQUEST, base_T_object=object_pose, tolerance=Tolerance(at=at))
    try:
        (warning,) = check_points(request, SCENE)
    except InvalidInput as error:
        return f"422 {error.detail} {error.remedy}"
    assert warning.code == "tolerance-points-far"
    return warning.detail + warning.remedy


def test_points_in_another_unit_or_frame_are_named() -> None:
    there = SCENE.cloud[:5]
    assert "in millimetres: send metres" in told(1000 * there)
    assert told(1000 * there).startswith("422 The points of tolerance.at are ")
    assert "in the camera's frame: send points in base" in told(VIEW.base_T_camera.inverse().apply(there))
    far = told(there + np.array([0.0, 0.5, 0.0]))
    assert "m from the object, in the median.Send points in base" in far
    assert "If the error counts there, this is right." in far
    assert told(there + np.array([0.0, 3.0, 0.0])).startswith("422")


def seen(name: str) -> tuple[Scene, Estimate, Case]:
    case = make_case(name, MAKERS[name](), 0)
    scene = Scene(case.depth, case.camera, case.base_T_camera, case.mask, case.world.table)
    return scene, from_prior(Prior(), scene.cloud), case


def test_a_round_objects_axis_is_offered_where_its_turn_matters() -> None:
    scene, prior, case = seen("can")
    (warning,) = check_symmetry(Tolerance(), scene, prior)
    assert warning.code == "object-round"
    axis = np.array(json.loads(warning.remedy.partition("such as ")[2].rstrip(".")))
    assert axis.shape == (2, 3)
    true = case.truth.apply(axis)
    np.testing.assert_allclose(true[:, :2] - [0.5, 0.0], 0.0, atol=0.006)
    assert 0 < true[0, 2] < true[1, 2]
    assert check_symmetry(Tolerance(at=axis), scene, prior) == ()
    assert check_symmetry(Tolerance(error=0.05), scene, prior) == ()


@pytest.mark.parametrize("name", ["box", "drill"])
def test_nothing_else_is_called_round(name: str) -> None:
    scene, prior, _ = seen(name)
    assert check_symmetry(Tolerance(), scene, prior) == ()
