"""Anchors, and rectangles told relative to others."""

import numpy as np
from hypothesis import given
from pretouch_detector.model.anchors import CELLS, SHAPES, anchors, decode, encode, quarter_turned
from pretouch_detector.overlap import overlap
from rotated_shapes import rectangles


@given(rectangles, rectangles)
def test_decoding_brings_back_what_was_encoded(origin: np.ndarray, goal: np.ndarray) -> None:
    origin[2:4], goal[2:4] = origin[2:4].clip(0.3, 1.1), goal[2:4].clip(0.3, 1.1)  # no side grows fourfold
    back = decode(origin[None], encode(origin[None], goal[None]))
    np.testing.assert_allclose(overlap(back, goal[None]), 1, atol=1e-9)
    assert -np.pi / 2 <= back[0, 4] < np.pi / 2


@given(rectangles, rectangles)
def test_a_goal_told_either_way_is_encoded_alike(origin: np.ndarray, goal: np.ndarray) -> None:
    once = encode(origin[None], goal[None])
    again = encode(origin[None], quarter_turned(goal[None], np.array([True])))
    if once[0, 4] > 1e-6:  # at 45 degrees both ways are as good
        np.testing.assert_allclose(once, again, atol=1e-9)
    assert once[0, 4] >= -1e-9


@given(rectangles, rectangles)
def test_mirrored_in_the_image_shift_across_and_turn_change_their_signs(origin: np.ndarray, goal: np.ndarray) -> None:
    mirror = np.array([-1, 1, 1, 1, -1])
    once, mirrored = encode(origin[None], goal[None])[0], encode((mirror * origin)[None], (mirror * goal)[None])[0]
    if once[4] > 1e-6:
        np.testing.assert_allclose(mirrored, once * [-1, 1, 1, 1, 1, -1], atol=1e-9)


def test_wild_deltas_leave_finite_rectangles() -> None:
    rng = np.random.default_rng(0)
    start = anchors()[:100]
    found = decode(start, rng.normal(0, 1e3, (100, 6)))
    assert np.isfinite(found).all()
    assert (found[:, 2:4] >= start[:, 2:4] / 4.001).all()
    assert (found[:, 2:4] <= start[:, 2:4] * 4.001).all()


def test_each_likely_rectangle_has_an_anchor_near() -> None:
    """Candidates of an object as large as the network sees it: 2/3 of the image, 10-50 % of its bounding rectangle."""
    rng = np.random.default_rng(0)
    n = 300
    area = rng.uniform(0.1, 0.5, n) * (4 / 3) ** 2
    width = np.sqrt(area * np.exp(rng.uniform(-1.2, 1.2, n)))
    candidates = np.column_stack(
        [rng.uniform(-2 / 3, 2 / 3, (n, 2)), width, area / width, rng.uniform(-np.pi / 2, np.pi / 2, n)]
    )
    assert (overlap(candidates, anchors()).max(axis=1) >= 0.5).all()


def test_anchors_stand_in_rows_of_cells() -> None:
    grid = anchors().reshape(CELLS, CELLS, SHAPES, 5)
    steps = (2 * np.arange(CELLS) + 1) / CELLS - 1
    np.testing.assert_allclose(grid[:, :, 0, 0], np.broadcast_to(steps, (CELLS, CELLS)))
    np.testing.assert_allclose(grid[:, :, 0, 1], np.broadcast_to(steps[:, None], (CELLS, CELLS)))
    np.testing.assert_allclose(grid[:, :, :, 2:], np.broadcast_to(grid[0, 0, :, 2:], (CELLS, CELLS, SHAPES, 3)))
