"""Non-maximum suppression: of two regions that overlap much the better one stays, decided exactly."""

import numpy as np
import pytest
from helpers.rotated_shapes import drawn, several, shapely_overlap
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pretouch_detector.suppression import MAX_OVERLAP, suppress_overlapping


def by_definition(shared: np.ndarray, count: int) -> list[int]:
    """Each is kept that overlaps no kept one before it by more than MAX_OVERLAP."""
    kept: list[int] = []
    for index in range(len(shared)):
        if len(kept) < count and all(shared[index, before] <= MAX_OVERLAP for before in kept):
            kept.append(index)
    return kept


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 12), room=st.floats(1.0, 40.0))
def test_the_same_as_one_by_one(seed: int, count: int, room: float) -> None:
    rng = np.random.default_rng(seed)
    low, high = (0, 0, 10, 10, -np.pi / 2), (room, room, 25, 25, np.pi / 2)
    ranked = rng.uniform(low, high, (30, 5))
    assert suppress_overlapping(ranked, count) == by_definition(shapely_overlap(ranked, ranked), count)


@settings(max_examples=60)
@given(several(1, 14))
def test_as_defined(rectangles: np.ndarray) -> None:
    shared = shapely_overlap(rectangles, rectangles)
    assume((np.abs(shared - MAX_OVERLAP) > 1e-9).all())  # shapely and the formula round differently
    assert suppress_overlapping(rectangles, len(rectangles)) == by_definition(shared, len(shared))


def test_as_defined_on_many() -> None:
    rectangles = drawn(np.random.default_rng(3), 200)
    expected = by_definition(shapely_overlap(rectangles, rectangles), 200)
    assert 1 < len(expected) < 200
    assert suppress_overlapping(rectangles, 200) == expected
    assert suppress_overlapping(rectangles, 5) == expected[:5]


def test_of_equal_ones_the_first_stays() -> None:
    assert suppress_overlapping(np.tile([0.0, 0.0, 1.0, 0.5, 0.3], (4, 1)), 4) == [0]


@pytest.mark.parametrize(("shift", "kept"), [(2.4, [0]), (2.6, [0, 1])])
def test_the_limit_is_a_share_of_the_union(shift: float, kept: list[int]) -> None:
    turned = 0.5
    second = (shift * np.cos(turned), shift * np.sin(turned), 10, 4, turned)
    assert suppress_overlapping(np.array([(0, 0, 10, 4, turned), second]), 5) == kept


def test_a_rectangle_named_by_its_other_sides_is_the_same() -> None:
    assert suppress_overlapping(np.array([(5.0, 5, 10, 4, -np.pi / 2), (5, 5, 4, 10, 0)]), 5) == [0]


def test_nothing_of_nothing() -> None:
    assert suppress_overlapping(np.zeros((0, 5)), 5) == []
