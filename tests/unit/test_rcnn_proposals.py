"""The two-stage design at work, with a second stage whose answers are known."""

import numpy as np
from numpy.typing import NDArray
from pretouch_detector.model.anchors import anchors, encode
from pretouch_detector.model.rcnn_proposals import APART, propose
from rotated_shapes import shapely_overlap

UNMOVED = np.array([0.0, 0, 0, 0, 1, 0])
FIRST = np.tile(UNMOVED, (len(anchors()), 1))


def error(rectangles: NDArray[np.floating]) -> NDArray[np.floating]:
    """m: the nearer to (0.3, -0.2), the less."""
    return 0.002 + 0.01 * np.hypot(rectangles[:, 0] - 0.3, rectangles[:, 1] + 0.2)


def head(rectangles: NDArray[np.float32]) -> tuple[NDArray, NDArray, NDArray]:
    n = len(rectangles)
    logs = np.column_stack([np.log(error(rectangles)), np.zeros(n)])
    return np.zeros(n), np.tile(UNMOVED, (n, 1)), logs


def all_of(rectangles: np.ndarray) -> NDArray[np.bool_]:
    return np.ones(len(rectangles), dtype=bool)


def objectness() -> np.ndarray:
    return np.random.default_rng(0).normal(size=len(anchors()))


def test_the_best_come_first_with_their_errors_and_none_overlaps_a_better_one_too_much() -> None:
    rectangles, errors = propose(objectness(), FIRST, head, all_of, 10)
    assert rectangles.shape == (10, 5)
    np.testing.assert_allclose(errors, error(rectangles), rtol=1e-5)
    assert (np.diff(errors) >= 0).all()
    shared = shapely_overlap(rectangles, rectangles)
    assert shared[~np.eye(10, dtype=bool)].max() <= APART


def test_an_anchor_that_stands_out_is_moved_to_where_the_first_stage_says() -> None:
    goal = np.array([[0.11, 0.07, 0.66, 0.41, 0.5]])
    scores, deltas = np.full(len(anchors()), -9.0), FIRST.copy()
    k = int(np.argmax(shapely_overlap(anchors(), goal)[:, 0]))
    scores[k], deltas[k] = 5.0, encode(anchors()[k : k + 1], goal)[0]

    def only_there(rectangles: NDArray[np.float32]) -> tuple[NDArray, NDArray, NDArray]:
        score, moves, logs = head(rectangles)
        logs[:, 0] = np.where(np.abs(rectangles - goal).max(axis=1) < 1e-4, -9.0, -3.0)
        return score, moves, logs

    rectangles, errors = propose(scores, deltas, only_there, all_of, 1)
    np.testing.assert_allclose(rectangles, goal, atol=1e-6)
    np.testing.assert_allclose(errors, np.exp(-9.0))


def test_what_the_second_stage_moves_competes_by_its_own_error() -> None:
    def to_the_right(rectangles: NDArray[np.float32]) -> tuple[NDArray, NDArray, NDArray]:
        score, moves, _ = head(rectangles)
        moves[:, :2] = np.column_stack([np.cos(rectangles[:, 4]), -np.sin(rectangles[:, 4])]) / rectangles[:, 2:4] * 5
        return score, moves, np.column_stack([np.where(rectangles[:, 0] > 2, -8.0, -4.0), np.zeros(len(rectangles))])

    rectangles, errors = propose(objectness(), FIRST, to_the_right, all_of, 4)
    assert (rectangles[:, 0] > 2).all()
    np.testing.assert_allclose(errors, np.exp(-8.0))


def test_only_what_is_allowed_is_proposed() -> None:
    def left(rectangles: np.ndarray) -> NDArray[np.bool_]:
        return np.asarray(rectangles[:, 0] < -0.1)

    rectangles, _ = propose(objectness(), FIRST, head, left, 10)
    assert len(rectangles) == 10
    assert (rectangles[:, 0] < -0.1).all()

    def nothing(rectangles: np.ndarray) -> NDArray[np.bool_]:
        return np.zeros(len(rectangles), dtype=bool)

    rectangles, errors = propose(objectness(), FIRST, head, nothing, 10)
    assert rectangles.shape == (0, 5)
    assert errors.shape == (0,)
