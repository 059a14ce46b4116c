"""The grid finds the same neighbours as a k-d tree, through any sequence of moves."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_registrar.engines.neighbours import (
    MAX_TARGET,
    build_index,
    find_neighbours,
    make_correspondences,
    subsample,
)
from pretouch_registrar.engines.rigid import compute_rotation
from scipy.spatial import cKDTree

from pretouch.geometry import rotation_from_vector

REACH = 0.05


def wavy(count: int, rng: np.random.Generator) -> np.ndarray:
    xy = rng.uniform(-0.05, 0.05, (count, 2))
    return np.column_stack([xy, 0.02 * np.sin(40 * xy[:, 1])]) + 0.5


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([1, 2, 7, 60, 900]))
def test_neighbours_are_exact_in_every_round(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    target = wavy(count, rng)
    source = wavy(80, rng) + rng.normal(0, 0.01, (80, 3))
    source[:8] += 0.1
    index, tree, pairs = build_index(target), cKDTree(target), make_correspondences(80)
    for turn in range(6):
        find_neighbours(source, index, REACH, pairs)
        distance, nearest = tree.query(source, distance_upper_bound=REACH)
        np.testing.assert_allclose(pairs.distance, distance, rtol=0, atol=1e-12)
        found = np.isfinite(distance)
        np.testing.assert_array_equal(index.order[pairs.neighbour[found]], nearest[found])
        source = source + rng.normal(0, 0.02 / 3**turn, (1, 3)) + rng.normal(0, 1e-4, (80, 3))


@pytest.mark.parametrize("shape", ["one place", "a line", "two far places"])
def test_targets_without_any_area_are_searched_too(shape: str) -> None:
    steps = np.linspace(0, 0.1, 500)[:, None]
    target = {
        "one place": np.zeros((500, 3)),
        "a line": steps * (1.0, 0.0, 0.0),
        "two far places": np.concatenate([np.zeros((250, 3)), np.full((250, 3), 1e3)]),
    }[shape]
    source = np.random.default_rng(0).uniform(-0.04, 0.04, (50, 3))
    pairs = make_correspondences(50)
    find_neighbours(source, build_index(target), 1.0, pairs)
    np.testing.assert_allclose(pairs.distance, cKDTree(target).query(source)[0], rtol=0, atol=1e-12)


def test_a_target_of_ten_million_points_is_thinned_evenly() -> None:
    target = np.broadcast_to(np.arange(10_000_000, dtype=np.float32)[:, None], (10_000_000, 3))
    kept = subsample(target)
    assert MAX_TARGET / 2 < len(kept) <= MAX_TARGET
    assert np.ptp(np.diff(kept[:, 0])) == 0
    assert kept[-1, 0] > 0.999 * 10_000_000


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10_000))
def test_the_closed_form_rotation_is_the_one_that_was_applied(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(int(rng.integers(3, 20)), 3)) * (1.0, 1.0, rng.choice([0.0, 1.0]))
    rotation = rotation_from_vector(rng.uniform(-1.7, 1.7, 3))
    centred = points - points.mean(axis=0)
    found = compute_rotation(centred.T @ (centred @ rotation.T))
    np.testing.assert_allclose(found, rotation, atol=1e-9)
