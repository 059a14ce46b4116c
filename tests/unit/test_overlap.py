"""The common area of rotated rectangles, beside shapely's."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_detector.proposals.overlap import common_area

from pretouch.rectangle import RotatedRectangle


def polygon(rectangle: np.ndarray) -> shapely.Polygon:
    return shapely.Polygon(RotatedRectangle(*rectangle).corners())


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), upright=st.booleans(), room=st.floats(1.0, 40.0))
def test_the_same_as_of_polygons(seed: int, upright: bool, room: float) -> None:
    rng = np.random.default_rng(seed)
    low, high = np.array((0, 0, 0.1, 0.1, -np.pi / 2)), np.array((room, room, 25, 25, np.pi / 2))
    rectangles = rng.uniform(low, high, (12, 5))
    if upright:  # sides lie on sides
        rectangles = np.rint(rectangles).clip((0, 0, 1, 1, 0), (40, 40, 25, 25, 0))
    first, others = rectangles[0], rectangles
    expected = [polygon(first).intersection(polygon(row)).area for row in others]
    np.testing.assert_allclose(common_area(first, others), expected, atol=1e-9)


@pytest.mark.parametrize("theta", [0.0, 0.3, -np.pi / 2, np.pi / 4])
def test_of_itself_of_one_within_and_of_one_apart(theta: float) -> None:
    rectangle = (3.0, -2.0, 10.0, 4.0, theta)
    others = np.array([rectangle, (3.0, -2.0, 2.0, 1.0, 0.1), (30.0, -2.0, 10.0, 4.0, theta)])
    np.testing.assert_allclose(common_area(rectangle, others), [40.0, 2.0, 0.0], atol=1e-12)


def test_of_none() -> None:
    assert common_area((0.0, 0.0, 1.0, 1.0, 0.0), np.zeros((0, 5))).shape == (0,)
