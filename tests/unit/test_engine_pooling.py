"""Pooling a wide beam's samples from about the same place reduces noise and keeps the information."""

import numpy as np
import pytest
from helpers.scenes import KINECT, Box, World
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_registrar.engines import camera_model
from pretouch_registrar.engines.camera_model import CameraModel
from pretouch_registrar.engines.registration_problem import RegistrationProblem, build_problem

from pretouch.geometry import Array
from pretouch.prior import Prior
from pretouch.tof import Scan, Sensor

SENSOR = Sensor(beam_half_angle=float(np.radians(12.5)))
HEIGHT = 0.08


@pytest.fixture(scope="module")
def block() -> CameraModel:
    return camera_model.build(World((Box.standing((0.10, 0.08, 0.04)),)).scene(KINECT))


def problem_of(model: CameraModel, x: Array, ranges: Array) -> RegistrationProblem:
    """Of a scan straight down from places along base x."""
    origins = np.column_stack([x, np.zeros(len(x)), np.full(len(x), HEIGHT)])
    down = np.tile([0.0, 0.0, -1.0], (len(x), 1))
    return build_problem(model, [Scan(origins, down, ranges)], Prior(), SENSOR)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 80), st.integers(0, 2**16))
def test_no_weight_is_lost_and_the_order_stays(block: CameraModel, count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    ranges = np.where(rng.uniform(size=count) < 0.2, np.nan, rng.uniform(0.03, 0.09, count))
    problem = problem_of(block, np.sort(rng.uniform(-0.05, 0.05, count)), ranges)
    pooled = problem.pool_beams()
    assert pooled.beams.weights.sum() == pytest.approx(problem.beams.weights.sum())
    assert len(pooled.beams.weights) <= 2 * 20
    for returned in (True, False):
        assert pooled.beams.weights[pooled.beams.returned == returned].sum() == pytest.approx(
            problem.beams.weights[problem.beams.returned == returned].sum()
        )
        x = pooled.beams.points[pooled.beams.returned == returned, 0]
        assert (np.diff(x) > 0).all()


def test_an_outlier_among_good_ranges_does_not_count(block: CameraModel) -> None:
    pooled = problem_of(block, np.linspace(0.0001, 0.0049, 5), np.array([0.04, 0.041, 0.09, 0.04, 0.039])).pool_beams()
    assert pooled.beams.ranges == pytest.approx([0.04])
    assert pooled.beams.points == pytest.approx(np.array([[0.0025, 0.0, HEIGHT - 0.04]]))


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 3000), st.integers(2, 400), st.integers(0, 2**16))
def test_merging_neighbours_loses_no_weight_and_moves_no_sample_far(
    block: CameraModel, count: int, most: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    places = rng.uniform((-0.05, -0.04, 0.03), (0.05, 0.04, 0.05), (count, 3))
    scan = Scan(places, np.tile([0.0, 0.0, -1.0], (count, 1)), np.where(rng.uniform(size=count) < 0.2, np.nan, 0.02))
    problem = build_problem(block, [scan], Prior(), Sensor())
    merged = problem.merge_neighbours(most)
    assert merged.beams.weights.sum() == pytest.approx(problem.beams.weights.sum())
    assert len(merged.beams.weights) <= count
    if count <= most:
        assert merged is problem
    for returned in (True, False):
        before, after = (b.points[b.returned == returned] for b in (problem.beams, merged.beams))
        assert len(before) == len(after) == 0 or np.abs(before.mean(axis=0) - after.mean(axis=0)).max() < 0.05
        for point in after[:20]:
            assert np.linalg.norm(before - point, axis=1).min() <= 0.008 * np.sqrt(3)


def test_merging_does_not_shift_a_noisy_surface(block: CameraModel) -> None:
    rng = np.random.default_rng(0)
    x = np.tile(np.linspace(-0.03, 0.03, 40), 50)
    origins = np.column_stack([x, np.zeros(len(x)), np.full(len(x), HEIGHT)])
    scan = Scan(origins, np.tile([0.0, 0.0, -1.0], (len(x), 1)), 0.04 + 0.004 * rng.standard_normal(len(x)))
    problem = build_problem(block, [scan], Prior(), Sensor(range_std=0.004))
    merged = problem.merge_neighbours(100)
    assert len(merged.beams.weights) <= 100
    before, after = (np.average(b.points[:, 2], weights=b.weights) for b in (problem.beams, merged.beams))
    assert after == pytest.approx(before, abs=2e-4)


@given(st.integers(1, 2000), st.sampled_from([1, 6, 64]))
def test_a_subsample_takes_all_modules_in_turn(block: CameraModel, count: int, modules: int) -> None:
    problem = problem_of(block, np.arange(count) % modules / 1e3, np.full(count, 0.04))
    kept = problem.subsample_beams(200)
    assert kept.beams.weights.sum() == pytest.approx(problem.beams.weights.sum())
    assert len(kept.beams.weights) == min(count, 200)
    if count >= 4 * modules:
        taken = np.unique(np.round(1e3 * kept.beams.points[:, 0]))
        assert len(taken) > 0.7 * min(modules, 200)
