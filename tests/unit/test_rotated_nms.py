"""Non-maximum suppression beside its definition."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pretouch_detector.model.nms import suppressed
from rotated_shapes import drawn, several, shapely_overlap


def by_definition(shared: np.ndarray, limit: float) -> list[int]:
    """Each is picked that overlaps no picked one before it by more than the limit."""
    picked: list[int] = []
    for index in range(len(shared)):
        if all(shared[index, before] <= limit for before in picked):
            picked.append(index)
    return picked


@settings(max_examples=60)
@given(several(1, 14), st.floats(0.05, 0.95))
def test_as_defined(rectangles: np.ndarray, limit: float) -> None:
    shared = shapely_overlap(rectangles, rectangles)
    assume((np.abs(shared - limit) > 1e-9).all())  # shapely and the formula round differently
    assert suppressed(rectangles, limit, len(rectangles)).tolist() == by_definition(shared, limit)


@pytest.mark.parametrize("limit", [0.1, 0.3, 0.6])
def test_as_defined_on_many(limit: float) -> None:
    rectangles = drawn(np.random.default_rng(3), 200)
    expected = by_definition(shapely_overlap(rectangles, rectangles), limit)
    assert 1 < len(expected) < 200
    assert suppressed(rectangles, limit, 200).tolist() == expected
    assert suppressed(rectangles, limit, 5).tolist() == expected[:5]


def test_of_equal_ones_the_first_stays() -> None:
    assert suppressed(np.tile([0.0, 0.0, 1.0, 0.5, 0.3], (4, 1)), 0.99, 4).tolist() == [0]


def test_of_none_none() -> None:
    assert suppressed(np.zeros((0, 5)), 0.5, 3).tolist() == []
