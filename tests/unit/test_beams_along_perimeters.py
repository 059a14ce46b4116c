"""The paths of beams along perimeters, and the covariance after such scans, against plain numpy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_detector.proposals.displaced import average_square_errors
from pretouch_detector.proposals.from_above import Grid, project_from_above
from pretouch_detector.proposals.paths import trace_perimeters

PIXEL, CELL = 0.002, 0.003
SIDE = 60
BOX = np.array([[30.0, 30.0, 24.0, 16.0, 0.0]])


def ground() -> np.ndarray:
    """Each pixel (u, v) shows the place (u, v) PIXEL."""
    v, u = np.indices((SIDE, SIDE))
    return np.stack([u, v], axis=-1) * PIXEL


def along(places: np.ndarray, boxes: np.ndarray, away: np.ndarray, beams: int = 40) -> tuple[np.ndarray, np.ndarray]:
    return trace_perimeters(boxes, places, (0, 0), 1, away, Grid(np.zeros(2), CELL, away.shape), 0.015, beams)


def test_a_path_goes_once_round_evenly() -> None:
    ways, lengths = along(ground(), BOX, np.zeros((40, 40)))
    assert lengths[0] == pytest.approx(2 * (24 + 16) * PIXEL, rel=0.03)
    offsets = np.abs(ways[0] / PIXEL - 30.0)
    outside = np.maximum(offsets[:, 0] - 12, offsets[:, 1] - 8)
    assert np.abs(outside).max() <= 0.75
    steps = np.linalg.norm(np.diff(ways[0], axis=0), axis=1)
    assert steps.max() < 1.6 * lengths[0] / 40


def test_stretches_that_show_nothing_are_crossed_straight() -> None:
    places = ground()
    places[:, 35:] = np.nan
    ways, lengths = along(places, BOX, np.zeros((40, 40)))
    assert ways[0, :, 0].max() <= 34 * PIXEL + 1e-9
    assert lengths[0] == pytest.approx((2 * 16 + 2 * 16) * PIXEL, rel=0.08)


def test_far_from_the_object_there_is_no_path() -> None:
    ways, lengths = along(ground(), BOX, np.full((40, 40), 0.02))
    assert lengths[0] == 0.0
    assert not ways.any()


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1))
def test_what_is_left_is_the_mean_of_the_inverses(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows, corner = rng.normal(size=(7, 9, 6)), np.array([-0.01, -0.012])
    ways = rng.uniform(-0.02, 0.02, (3, 12, 2))
    shifts = rng.normal(size=(4, 3)) * (0.004, 0.004, 0.3)
    root = rng.normal(size=(6, 6))
    precision, lever = root @ root.T + np.eye(6), rng.normal(size=(6, 6))
    independent = rng.uniform(0.1, 2.0, 3)
    found = average_square_errors(rows, Grid(corner, CELL, (7, 9)), ways, independent, shifts, precision, lever)
    for n in range(3):
        left = []
        for x, y, turn in shifts:
            back = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
            cells = np.rint(((ways[n] - (x, y)) @ back.T - corner) / CELL).astype(int).clip(0, (6, 8))
            beams = rows[cells[:, 0], cells[:, 1]]
            covariance = np.linalg.inv(independent[n] * beams.T @ beams + precision)
            left.append(np.trace(lever.T @ covariance @ lever))
        assert found[n] == pytest.approx(np.mean(left), rel=1e-7)


def test_object_and_table_are_told_apart_from_above_and_the_highest_counts() -> None:
    """A camera 1 m above the table looks straight down: pixel (u, v) at depth z shows ((u - 2) z, (v - 2) z)."""
    depth = np.full((5, 5), 1.0, np.float32)
    depth[2, 2], depth[2, 3], depth[0, 0], depth[1, 1] = 0.9, 0.8, 0.0, 0.7
    mask = np.zeros((5, 5), bool)
    mask[2, 2:4] = True
    turn, shift = np.diag([1.0, 1.0, -1.0]), np.array([0.0, 0.0, 1.0])
    camera = np.array([1.0, 1.0, 2.0, 2.0])
    grid = Grid(np.array([0.0, -1.0]), 1.0, (3, 3))
    places, top, ground = project_from_above(depth, mask, camera, turn, shift, 0.015, grid)
    np.testing.assert_allclose(places[2, 3], [0.8, 0.0])
    np.testing.assert_allclose(places[3, 4], [2.0, 1.0])
    assert np.isnan(places[0, 0]).all()  # no depth
    assert np.isnan(places[1, 1]).all()  # neither object nor table
    np.testing.assert_allclose([top[0, 1], top[1, 1]], [0.1, 0.2], atol=1e-6)
    assert np.isneginf(top).sum() == 7
    np.testing.assert_allclose(ground[np.isfinite(ground)], 0.0, atol=1e-6)
    assert np.argwhere(np.isneginf(ground)).tolist() == [[0, 1], [1, 1]]  # which the object hides
