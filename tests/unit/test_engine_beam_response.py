"""The hypotheses about a wide beam: calibrated on the same wall; shorter pulses weight the nearest part more."""

from typing import NamedTuple

import numpy as np
import pytest
from helpers.scenes import KINECT, Box, World
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_registrar.engines import camera_model
from pretouch_registrar.engines.beam_response import CALIBRATION_DISTANCE, Cone, make_cone, make_thin_beam
from pretouch_registrar.engines.camera_model import CameraModel
from pretouch_registrar.engines.registration_problem import build_problem
from pretouch_registrar.engines.residuals.cone import make_spot, spot_residual, trace_spot

from pretouch.geometry import Array
from pretouch.prior import Prior
from pretouch.tof import Sensor

HALF_ANGLE = float(np.radians(12.5))
CONE = make_cone(HALF_ANGLE)
HYPOTHESES = len(CONE.scales)
DOWN = (0.0, 0.0, -1.0)
TOP = 0.04
"""m: the block's height; its edges are at 0.05 m along x and 0.04 m along y."""


@pytest.fixture(scope="module")
def block() -> CameraModel:
    return camera_model.build(World((Box.standing((0.10, 0.08, TOP)),)).scene(KINECT))


class Seen(NamedTuple):
    """What a module should measure: (h,) ranges over the nearest and the farthest surface, variances of the paths."""

    interval: bool
    nearest: Array
    means: Array
    spreads: Array

    def by_length(self, values: Array) -> Array:
        """(w, l): a row for each width, the pulses from the longest to the shortest."""
        return values.reshape(len(CONE.profiles), len(CONE.decays))


def seen(
    model: CameraModel, at: tuple[float, float, float], down: tuple[float, float, float] = DOWN, cone: Cone = CONE
) -> Seen:
    target = build_problem(model, [], Prior(), Sensor(beam_half_angle=HALF_ANGLE)).target
    spot = make_spot(cone)
    interval = trace_spot(at, down, True, 0.0, target, cone, spot)
    return Seen(interval, spot.nearest if interval else spot.means, spot.means, spot.spreads)


@given(st.floats(0.05, 0.45))
def test_every_hypothesis_reads_the_wall_of_the_calibration_as_it_is(half_angle: float) -> None:
    cone = make_cone(half_angle)
    paths = CALIBRATION_DISTANCE * cone.length
    for w, profile in enumerate(cone.profiles):
        for b, decay in enumerate(cone.decays):
            weight = profile * np.cos(np.arctan(np.hypot(cone.across_x, cone.across_y)))
            weight = weight / paths**2 * np.exp(-(paths - CALIBRATION_DISTANCE) * decay)
            reads = cone.scales[w * len(cone.decays) + b] * np.average(paths, weights=weight)
            assert reads == pytest.approx(CALIBRATION_DISTANCE, abs=1e-9)


def test_over_a_flat_table_all_hypotheses_read_the_calibrated_distance_exactly(block: CameraModel) -> None:
    answer = seen(block, (0.0, -0.16, CALIBRATION_DISTANCE))
    assert not answer.interval
    np.testing.assert_allclose(answer.means, CALIBRATION_DISTANCE, atol=1e-9)


@settings(max_examples=40)
@given(st.floats(-0.02, 0.02), st.floats(-0.01, 0.01))
def test_over_an_objects_flat_top_all_hypotheses_read_the_calibrated_distance(
    block: CameraModel, x: float, y: float
) -> None:
    answer = seen(block, (x, y, TOP + CALIBRATION_DISTANCE))
    np.testing.assert_allclose(answer.nearest, answer.means, atol=1e-6)
    np.testing.assert_allclose(answer.means, CALIBRATION_DISTANCE, atol=3e-4)


@settings(max_examples=40)
@given(st.floats(0.02, 0.08), st.floats(-0.02, 0.02), st.floats(-0.01, 0.01))
def test_a_wide_beam_on_a_wall_reads_its_distance(block: CameraModel, height: float, x: float, y: float) -> None:
    answer = seen(block, (x, y, TOP + height))
    np.testing.assert_allclose(answer.means, height, atol=0.0015)
    assert (answer.spreads < 0.004**2).all()


@settings(max_examples=40)
@given(st.floats(-0.08, -0.02), st.floats(-0.06, 0.02), st.floats(0.06, 0.09), st.floats(-0.2, 0.2))
def test_the_shorter_the_pulse_the_more_the_nearest_part_counts(
    block: CameraModel, x: float, y: float, height: float, lean: float
) -> None:
    answer = seen(block, (x, y, height), (np.sin(lean), 0.0, -np.cos(lean)))
    assert (np.diff(answer.by_length(answer.means / CONE.scales), axis=1) < 0).all()


@settings(max_examples=40)
@given(st.floats(-0.054, -0.046), st.floats(-0.02, 0.02), st.floats(0.07, 0.09))
def test_over_a_step_the_range_falls_with_the_pulses_length_from_between_both_sides_to_the_upper_one(
    block: CameraModel, x: float, y: float, height: float
) -> None:
    ranges = seen(block, (x, y, height)).by_length(seen(block, (x, y, height)).means)
    assert (np.diff(ranges, axis=1) < 0).all()
    assert (ranges > height - TOP - 0.002).all()
    assert (ranges < height).all()


def test_over_an_edge_a_wide_beam_reads_something_between(block: CameraModel) -> None:
    inner, edge, outer = (seen(block, (x, 0.0, 0.08)) for x in (-0.03, -0.05, -0.08))
    plain = [0, len(CONE.decays)]  # of both widths the hypothesis in which near and far count alike
    assert (inner.means[plain] + 0.005 < edge.means[plain]).all()
    assert (edge.means < outer.means - 0.005).all()
    assert (edge.spreads[plain] > 16 * inner.spreads[plain]).all()


def test_over_what_the_camera_did_not_see_the_range_is_an_interval(block: CameraModel) -> None:
    answer = seen(block, (0.06, 0.0, 0.08))
    assert answer.interval
    plain = [0, len(CONE.decays)]
    assert (answer.nearest[plain] < answer.means[plain] - 0.005).all()
    assert (answer.means < 0.085).all()


@settings(max_examples=40)
@given(
    st.integers(0, HYPOTHESES - 1), st.floats(-0.08, 0.08), st.floats(-0.06, 0.06), st.floats(0.05, 0.09),
    st.floats(-0.2, 0.2),
)  # fmt: skip
def test_one_hypothesis_alone_says_what_it_says_among_all(
    block: CameraModel, hypothesis: int, x: float, y: float, height: float, lean: float
) -> None:
    at, down = (x, y, height), (0.0, np.sin(lean), -np.cos(lean))
    whole, alone = seen(block, at, down), seen(block, at, down, CONE.select_hypothesis(hypothesis))
    assert whole.interval == alone.interval
    for one, among in zip(alone[1:], whole[1:], strict=True):
        assert one.shape == (1,)
        assert one[0] == pytest.approx(among[hypothesis], rel=1e-9, abs=1e-12)


def test_a_range_within_the_interval_of_what_is_hidden_costs_only_the_hidden_part(block: CameraModel) -> None:
    problem = build_problem(block, [], Prior(), Sensor(beam_half_angle=HALF_ANGLE))
    at, cone = (0.06, 0.0, 0.08), CONE.select_hypothesis(0)
    spot = make_spot(cone)
    assert trace_spot(at, DOWN, True, 0.0, problem.target, cone, spot)
    nearest, farthest = spot.nearest[0], spot.means[0]

    def residual(measured: float) -> float:
        return float(spot_residual(0, True, measured, True, 0.1, problem.noise, spot)[0])

    assert residual(0.7 * nearest + 0.3 * farthest) == 0
    assert residual(farthest) == 0
    assert residual(farthest + 0.01) > 0
    assert residual(nearest - 0.01) != 0


def test_what_stands_beside_the_object_is_in_the_spot_too() -> None:
    neighbour = Box.standing((0.03, 0.08, 0.06), at=(0.08, 0.0))
    model = camera_model.build(World((Box.standing((0.10, 0.08, TOP)), neighbour)).scene(KINECT))
    over_the_neighbour = seen(model, (0.08, 0.0, 0.09), cone=make_cone(np.radians(5.0)))
    assert over_the_neighbour.means == pytest.approx(0.03, abs=0.002)


def test_a_thin_beam_has_no_hypotheses() -> None:
    assert len(make_thin_beam().scales) == len(make_thin_beam().length) == 0
    assert not is_problem_wide(0.0)
    assert is_problem_wide(HALF_ANGLE)


def is_problem_wide(half_angle: float) -> bool:
    model = camera_model.build(World((Box.standing((0.10, 0.08, TOP)),)).scene())
    return build_problem(model, [], Prior(), Sensor(beam_half_angle=half_angle)).wide


@settings(max_examples=40)
@given(st.floats(0.015, 0.04), st.floats(-0.02, 0.02), st.sampled_from([1.0, -1.0]))
def test_a_sideways_module_reads_the_wall_beside_it(block: CameraModel, away: float, y: float, side: float) -> None:
    answer = seen(block, (side * (0.05 + away), y, 0.75 * TOP), (-side, 0.0, 0.0))
    np.testing.assert_allclose(answer.by_length(answer.means)[:, -1], away, atol=0.006)


def test_a_sideways_module_above_everything_reads_nothing_near(block: CameraModel) -> None:
    answer = seen(block, (0.08, 0.0, TOP + 0.06), (-1.0, 0.0, 0.0))
    assert (answer.means > 0.1).all()


@settings(max_examples=40)
@given(st.floats(0.0, 2 * np.pi), st.floats(0.1, 0.75))
def test_over_a_flat_table_a_slanted_module_reads_more_the_more_it_slants(
    block: CameraModel, about: float, slant: float
) -> None:
    def read(by: float) -> Array:
        down = (np.sin(by) * np.cos(about), np.sin(by) * np.sin(about), -np.cos(by))
        return seen(block, (0.0, -0.25, 0.04), (float(down[0]), float(down[1]), float(down[2]))).means

    assert (read(slant) > read(0.0)).all()
