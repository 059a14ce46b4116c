"""Common area and intersection over union of rotated rectangles, against shapely and by their invariants."""

import numpy as np
import pytest
from helpers.rotated_shapes import rectangles, several, shapely_overlap
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_detector.overlap import compute_common_areas, compute_intersection_over_union


def overlap(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(n, m): of all with all."""
    return np.array([[compute_intersection_over_union(one, other) for other in second] for one in first])


@settings(max_examples=60)
@given(several(1, 6), several(1, 6))
def test_the_same_as_shapely(first: np.ndarray, second: np.ndarray) -> None:
    np.testing.assert_allclose(overlap(first, second), shapely_overlap(first, second), atol=1e-9)


@given(several(1, 6), several(1, 6))
def test_symmetric_and_between_0_and_1(first: np.ndarray, second: np.ndarray) -> None:
    found = overlap(first, second)
    assert ((found >= 0) & (found <= 1)).all()
    np.testing.assert_allclose(found, overlap(second, first).T, atol=1e-12)


@given(rectangles)
def test_with_itself_told_either_way_it_is_1(rectangle: np.ndarray) -> None:
    x, y, w, h, theta = rectangle
    quarter_turned = np.array([x, y, h, w, theta + np.pi / 2])
    np.testing.assert_allclose(
        [
            compute_intersection_over_union(rectangle, rectangle),
            compute_intersection_over_union(rectangle, quarter_turned),
        ],
        1,
        atol=1e-9,
    )


@given(rectangles, rectangles, st.floats(-3, 3), st.floats(-3, 3), st.floats(0.2, 5), st.booleans())
def test_moved_scaled_turned_or_mirrored_together_they_overlap_as_before(
    first: np.ndarray, second: np.ndarray, shift: float, turn: float, scale: float, mirror: bool
) -> None:
    def moved(row: np.ndarray) -> np.ndarray:
        x, y, w, h, theta = row
        c, s = np.cos(turn), np.sin(turn)
        x, y, theta = c * x - s * y + shift, s * x + c * y - shift, theta + turn
        if mirror:
            x, theta = -x, -theta
        return np.array([scale * x, scale * y, scale * w, scale * h, theta])

    assert compute_intersection_over_union(moved(first), moved(second)) == pytest.approx(
        compute_intersection_over_union(first, second), abs=1e-9
    )


@pytest.mark.parametrize("theta", [0.0, 0.3, -np.pi / 2, np.pi / 4])
def test_one_beside_many_of_itself_of_one_within_and_of_one_apart(theta: float) -> None:
    rectangle = (3.0, -2.0, 10.0, 4.0, theta)
    others = np.array([rectangle, (3.0, -2.0, 2.0, 1.0, 0.1), (30.0, -2.0, 10.0, 4.0, theta)])
    np.testing.assert_allclose(compute_common_areas(rectangle, others), [40.0, 2.0, 0.0], atol=1e-12)
    found = [compute_common_areas(other, [rectangle])[0] for other in others]
    np.testing.assert_allclose(found, [40.0, 2.0, 0.0], atol=1e-12)


def test_of_none_there_is_none() -> None:
    assert compute_common_areas((0.0, 0.0, 1.0, 1.0, 0.0), np.zeros((0, 5))).shape == (0,)
