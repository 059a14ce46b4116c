"""Running moments, their axes and the sort, against numpy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pretouch_detector.proposals.narf.moments import COUNT, MOMENTS, add_point, compute_axes
from pretouch_detector.proposals.narf.order import sort

from pretouch.geometry import Array

ONE = np.float32(1)


def moments_of(points: Array, weights: Array | None = None) -> Array:
    moments = np.zeros(MOMENTS, np.float32)
    for k, point in enumerate(points.astype(np.float32)):
        add_point(moments, point, ONE if weights is None else np.float32(weights[k]))
    return moments


def axes_of(moments: Array) -> tuple[Array, Array]:
    values, vectors = np.empty(3, np.float32), np.empty((3, 3), np.float32)
    compute_axes(moments, values, vectors)
    return values, vectors


def test_moments_are_the_weighted_mean_and_covariance() -> None:
    rng = np.random.default_rng(0)
    points, weights = rng.normal((0.1, -0.05, 0.9), (0.02, 0.01, 0.002), (40, 3)), rng.uniform(0.1, 1.0, 40)
    weights[7] = 0.0
    moments = moments_of(points, weights)
    centred = points - np.average(points, axis=0, weights=weights)
    covariance = (weights[:, None] * centred).T @ centred / weights.sum()
    np.testing.assert_allclose(moments[:3], np.average(points, axis=0, weights=weights), atol=1e-6)
    np.testing.assert_allclose(moments[3:9], covariance[np.triu_indices(3)], atol=1e-8)
    assert moments[COUNT] == 39


@settings(max_examples=60, deadline=None)
@given(
    turn=arrays(np.float64, (3, 3), elements=st.floats(-1, 1)),
    spread=st.tuples(*[st.floats(1e-3, 0.1)] * 3).filter(lambda s: min(np.diff(sorted(s))) > 1e-3),
)
def test_axes_are_the_eigenvectors(turn: Array, spread: tuple[float, ...]) -> None:
    rotation, _ = np.linalg.qr(turn + 2 * np.eye(3))
    covariance = rotation @ np.diag(np.square(spread)) @ rotation.T
    moments = np.zeros(MOMENTS, np.float32)
    moments[3:9] = covariance[np.triu_indices(3)]
    values, vectors = axes_of(moments)
    np.testing.assert_allclose(values, np.sort(np.square(spread)), atol=1e-3 * max(spread) ** 2)
    np.testing.assert_allclose(vectors @ vectors.T, np.eye(3), atol=1e-3)
    np.testing.assert_allclose(vectors @ covariance, values[:, None] * vectors, atol=2e-3 * max(spread) ** 2)


@pytest.mark.parametrize(
    "covariance", [np.zeros((3, 3)), np.eye(3), np.diag([1.0, 1.0, 4.0]), np.diag([1.0, 4.0, 4.0])]
)
def test_axes_of_equal_spread_are_orthogonal_all_the_same(covariance: Array) -> None:
    moments = np.zeros(MOMENTS, np.float32)
    moments[3:9] = covariance[np.triu_indices(3)]
    values, vectors = axes_of(moments)
    np.testing.assert_allclose(vectors @ vectors.T, np.eye(3), atol=1e-5)
    np.testing.assert_allclose(vectors @ covariance @ vectors.T, np.diag(values), atol=1e-5)


@settings(max_examples=200, deadline=None)
@given(st.lists(st.integers(-5, 5), max_size=120))
def test_sort_rises_and_keeps_each_number_with_its_item(numbers: list[int]) -> None:
    keys, items = np.array(numbers, np.float32), np.arange(len(numbers))
    sort(keys, items, len(numbers))
    assert keys.tolist() == sorted(numbers)
    assert sorted(items.tolist()) == list(range(len(numbers)))
    assert [numbers[k] for k in items] == sorted(numbers)
