"""Weakly observable directions: their standard deviations, and texts that name the right axis."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.scenes import Box, World
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_registrar.observability import FREE_STD, find_weak_directions
from pretouch_simulation.objects import MAKERS
from pretouch_simulation.protocol import make_case

from pretouch.estimate import WeakDirection
from pretouch.geometry import Array, rotation_from_vector
from pretouch.rotational_symmetry import find_symmetry_axis

UP = np.array([0.0, 0.0, 1.0])
CLOUD = World((Box.standing((0.10, 0.06, 0.05), yaw=0.4),)).scene().cloud
BAR = np.random.default_rng(0).uniform(-0.5, 0.5, (500, 3)) * [0.2, 0.02, 0.02] @ rotation_from_vector([0, 0, 0.35]).T
ARMS = CLOUD - CLOUD.mean(axis=0)
RADIUS = float(np.sqrt((ARMS**2).sum(axis=1).mean()))


def covariance(*free: tuple[list[float], float]) -> Array:
    """Tight (0.1 mm, 1 mrad) but for the given (rotation vector, translation) directions and their deviations."""
    tight = np.diag([1e-6] * 3 + [1e-8] * 3)
    for direction, std in free:
        vector = np.array(direction)
        tight += std**2 * np.outer(vector, vector)
    return tight


def about(axis: Array, point: Array, cloud: Array) -> list[float]:
    """The pose direction (6,) of one radian about `axis` through `point`."""
    return [*axis, *np.cross(axis, cloud.mean(axis=0) - point)]


def only(found: tuple[WeakDirection, ...]) -> str:
    (weak,) = found
    return weak.text


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.0, 1.0))
def test_each_direction_has_the_deviation_it_claims_and_none_is_left_out(seed: int, alike: float) -> None:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(6, 6)) * (rng.uniform(1e-4, 0.03, 6) ** (1 - alike)) * 0.01**alike
    given_covariance = root @ root.T + 1e-9 * np.eye(6)
    found = find_weak_directions(given_covariance, CLOUD, UP)
    scale = np.array([RADIUS] * 3 + [1.0] * 3)
    scaled = given_covariance * np.outer(scale, scale)
    directions = np.array([weak.direction for weak in found]).reshape(-1, 6)
    stds = np.array([weak.std for weak in found])
    np.testing.assert_allclose(directions @ directions.T, np.eye(len(found)), atol=1e-9)
    np.testing.assert_allclose(np.sqrt(np.einsum("ki,ij,kj->k", directions, scaled, directions)), stds, rtol=1e-6)
    assert (np.diff(stds) <= 0).all()
    assert (stds > FREE_STD).all()
    rest = np.eye(6) - directions.T @ directions
    assert np.sqrt(np.linalg.eigvalsh(rest @ scaled @ rest).max()) <= 1.7 * FREE_STD  # 1.1 for each of five neighbours
    values = np.sqrt(np.linalg.eigvalsh(scaled)[::-1][: len(found)])
    np.testing.assert_allclose(stds, values, rtol=0.7)
    assert all(weak.text.endswith(("mm)", "deg)")) for weak in found)


@settings(max_examples=40, deadline=None)
@given(st.floats(0.004, 0.1), st.integers(0, 2))
def test_a_single_free_translation_is_named_with_its_millimetres(std: float, along: int) -> None:
    direction = [0.0] * 6
    direction[3 + along] = 1.0
    words = ["sliding along base x", "sliding along base y", "height above the table"][along]
    wide = np.hypot(std, 1e-4)
    assert only(find_weak_directions(covariance((direction, std)), CLOUD, UP)) == f"{words} (±{1000 * wide:.1f} mm)"


@settings(max_examples=40, deadline=None)
@given(st.floats(0.1, 0.5), st.tuples(*[st.floats(-0.02, 0.02)] * 2))
def test_a_turn_about_an_upright_axis_near_the_middle_is_one_about_the_vertical(
    std: float, beside: tuple[float, float]
) -> None:
    point = CLOUD.mean(axis=0) + np.array([*beside, 0.0])
    text = only(find_weak_directions(covariance((about(UP, point, CLOUD), std)), CLOUD, UP))
    assert text.startswith("rotation about the vertical through the object (±")
    assert float(text.split("±")[1].split(" ")[0]) == pytest.approx(np.degrees(std), rel=0.1)


def test_a_turn_about_a_far_axis_says_where_the_axis_is() -> None:
    point = CLOUD.mean(axis=0) + np.array([0.06, 0.0, 0.0])
    text = only(find_weak_directions(covariance((about(UP, point, CLOUD), 0.1)), CLOUD, UP))
    assert text.startswith("rotation about the vertical through (0.")
    assert "m, 60 mm from the object's middle (±" in text


def test_a_turn_about_a_level_axis_is_a_tilt() -> None:
    text = only(find_weak_directions(covariance(([0, 1, 0, 0, 0, 0], 0.2)), CLOUD, UP))
    assert text == "tilt about base y through the object (±11.5 deg)"


def test_the_objects_long_axis_is_named() -> None:
    long = rotation_from_vector([0, 0, 0.35])[:, 0]
    sliding = only(find_weak_directions(covariance(([0, 0, 0, *long], 0.01)), BAR, UP))
    assert sliding == "sliding along the object's long axis, base (0.94, 0.34, 0.00) (±10.0 mm)"
    rolling = only(find_weak_directions(covariance(([*long, 0, 0, 0], 1.0)), BAR, UP))
    assert rolling.startswith("rotation about the object's long axis, base (0.94, 0.34, 0.00) through the object")


def test_equally_free_directions_are_told_along_the_axes_of_base() -> None:
    texts = [weak.text for weak in find_weak_directions(covariance(*_translations(0.0115, 0.0113, 0.0111)), CLOUD, UP)]
    assert {text.split(" (±")[0] for text in texts} == {
        "sliding along base x",
        "sliding along base y",
        "height above the table",
    }


def _translations(*stds: float) -> list[tuple[list[float], float]]:
    turn = rotation_from_vector([0.3, -0.5, 0.8])
    return [([0.0, 0.0, 0.0, *turn[:, k]], std) for k, std in enumerate(stds)]


@pytest.mark.parametrize("name", ["can", "bottle", "bowl", "box", "drill"])
@pytest.mark.parametrize("seed", range(2))
def test_only_round_things_look_round_about_the_vertical(name: str, seed: int) -> None:
    case = make_case(name, MAKERS[name](), 0, seed)
    cloud = case.truth.apply(case.cloud)
    found = find_symmetry_axis(cloud, UP)
    if name not in ("can", "bottle", "bowl"):
        assert found is None
        return
    assert found is not None
    assert np.linalg.norm(found.point[:2] - [0.5, 0.0]) < 0.008
    text = only(find_weak_directions(covariance((about(UP, found.point, cloud), 0.3)), cloud, UP))
    assert text.startswith("rotation about the vertical through the object, about which it looks round (±17.")
