"""Pooling a wide beam's samples from about the same place reduces noise and keeps the information."""

import numpy as np
import pytest
from helpers.scenes import KINECT, Box, World
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_registrar.engines import camera_model
from pretouch_registrar.engines.camera_model import CameraModel
from pretouch_registrar.engines.registration_problem import RegistrationProblem, build_problem

from pretouch.estimate import Prior
from pretouch.geometry import Array
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
