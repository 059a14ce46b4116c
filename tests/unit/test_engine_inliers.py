"""Samples at the true pose are inliers; impossible ones contradict it; those on hidden surfaces do neither."""

import numpy as np
import pytest
from helpers.scenes import KINECT, Box, World
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_registrar.engines import camera_model
from pretouch_registrar.engines.camera_model import CameraModel
from pretouch_registrar.engines.inliers import Classification, classify_samples
from pretouch_registrar.engines.registration_problem import RegistrationProblem, build_problem

from pretouch.geometry import Array, Pose, rotation_from_vector
from pretouch.prior import Prior
from pretouch.tof import Scan, Sensor

HALF_ANGLE = float(np.radians(12.5))
BLOCK = World((Box.standing((0.10, 0.08, 0.04)),))
AT_TRUTH = np.zeros(6)
DOWN = np.array([0.0, 0.0, -1.0])
BOTH = pytest.mark.parametrize("half_angle", [0.0, HALF_ANGLE], ids=["thin", "wide"])
seeds = st.integers(0, 2**16)


@pytest.fixture(scope="module")
def block() -> CameraModel:
    return camera_model.build(BLOCK.scene(KINECT, np.random.default_rng(3)).cropped(0.1)[0])


def problem_of(
    model: CameraModel, xy: Array, ranges: Array, half_angle: float = 0.0, height: float = 0.085
) -> RegistrationProblem:
    """Beams that look down from `height` above the places xy (n, 2)."""
    origins = np.column_stack([xy, np.full(len(xy), height)])
    scan = Scan(origins, np.tile(DOWN, (len(xy), 1)), ranges)
    return build_problem(model, [scan], Prior(), Sensor(beam_half_angle=half_angle))


def within_top(rng: np.random.Generator, count: int = 15) -> Array:
    return np.asarray(rng.uniform((-0.03, -0.02), (0.03, 0.02), (count, 2)))


def within_table(rng: np.random.Generator, count: int = 15) -> Array:
    return np.asarray(rng.uniform((-0.03, 0.08), (0.03, 0.1), (count, 2)))


def neither(classification: Classification) -> Array:
    return np.asarray(~classification.inlier & ~classification.contradicting)


@BOTH
@settings(max_examples=25)
@given(seed=seeds)
def test_what_is_measured_at_the_truth_agrees(block: CameraModel, half_angle: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    xy = np.concatenate([within_top(rng), within_table(rng)])
    noise = rng.normal(0, 0.001, len(xy)).clip(-0.002, 0.002)
    ranges = np.where(np.arange(len(xy)) < 15, 0.045, 0.085) + noise
    classification = classify_samples(AT_TRUTH, problem_of(block, xy, ranges, half_angle))
    assert classification.inlier.all()
    assert not classification.contradicting.any()
    np.testing.assert_allclose(classification.residuals, -noise if half_angle == 0 else noise, atol=0.0025)


@BOTH
@settings(max_examples=25)
@given(seed=seeds, depth=st.floats(0.015, 0.035))
def test_what_would_lie_inside_the_seen_object_contradicts(
    block: CameraModel, half_angle: float, seed: int, depth: float
) -> None:
    xy = within_top(np.random.default_rng(seed))
    classification = classify_samples(AT_TRUTH, problem_of(block, xy, np.full(15, 0.045 + depth), half_angle))
    assert classification.contradicting.all()
    assert not classification.inlier.any()


@BOTH
@settings(max_examples=25)
@given(seed=seeds, rise=st.floats(0.015, 0.035), table=st.booleans())
def test_what_would_hang_in_the_air_where_the_camera_looked_through_contradicts(
    block: CameraModel, half_angle: float, seed: int, rise: float, table: bool
) -> None:
    rng = np.random.default_rng(seed)
    xy = within_table(rng) if table else within_top(rng)
    classification = classify_samples(
        AT_TRUTH, problem_of(block, xy, np.full(15, (0.085 if table else 0.045) - rise), half_angle)
    )
    assert classification.contradicting.all()
    assert not classification.inlier.any()


@BOTH
def test_a_miss_contradicts_where_something_was_seen_within_range_and_nowhere_else(
    block: CameraModel, half_angle: float
) -> None:
    none = np.full(15, np.nan)
    over_the_block = within_top(np.random.default_rng(0))
    classification = classify_samples(AT_TRUTH, problem_of(block, over_the_block, none, half_angle, height=0.07))
    assert classification.contradicting.all()
    high = classify_samples(AT_TRUTH, problem_of(block, over_the_block, none, half_angle, height=0.25))
    assert neither(high).all()
    for one in (classification, high):
        assert not one.inlier.any()
        assert not one.residuals.any()


def test_a_hidden_side_neither_agrees_nor_contradicts(block: CameraModel) -> None:
    """The camera stands at negative x: what lies lower behind the block's far edge it could not have seen."""
    xy = np.column_stack([np.full(9, 0.065), np.linspace(-0.02, 0.02, 9)])
    assert neither(classify_samples(AT_TRUTH, problem_of(block, xy, np.full(9, 0.07)))).all()


@BOTH
@settings(max_examples=25)
@given(seed=seeds)
def test_a_correction_carries_the_samples_back_to_where_they_agree(
    block: CameraModel, half_angle: float, seed: int
) -> None:
    """All turned and shifted together, with the correction: as at the truth. Without it they are not explained."""
    rng = np.random.default_rng(seed)
    x = np.concatenate([rng.uniform(-0.06, 0.06, 3), rng.uniform(-0.015, 0.015, 2), [0.012]])
    rotation, centroid = rotation_from_vector(x[:3]), block.scene.centroid
    moved = Pose.of(rotation, centroid + x[3:] - rotation @ centroid)
    origins = np.column_stack([within_top(rng), np.full(15, 0.085)])
    scan = Scan(moved.apply(origins), np.tile(moved.rotate(DOWN), (15, 1)), np.full(15, 0.045))
    problem = build_problem(block, [scan], Prior(), Sensor(beam_half_angle=half_angle))
    assert classify_samples(x, problem).inlier.all()
    assert classify_samples(AT_TRUTH, problem).inlier.sum() < 15


@BOTH
@settings(max_examples=25)
@given(seed=seeds)
def test_each_sample_is_classified_by_itself_and_never_as_both(
    block: CameraModel, half_angle: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-0.09, 0.09, (40, 2))
    ranges = np.where(rng.random(40) < 0.2, np.nan, rng.uniform(0.02, 0.1, 40))
    problem = problem_of(block, xy, ranges, half_angle)
    order = rng.permutation(40)
    whole, mixed = (
        classify_samples(AT_TRUTH, problem),
        classify_samples(AT_TRUTH, problem_of(block, xy[order], ranges[order], half_angle)),
    )
    assert not (whole.inlier & whole.contradicting).any()
    assert not whole.inlier[np.isnan(ranges)].any()
    assert np.isfinite(whole.residuals).all()
    for one, other in zip(whole, mixed, strict=True):
        np.testing.assert_array_equal(one[order], other)
