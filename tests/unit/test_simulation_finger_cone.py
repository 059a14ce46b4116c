"""The cone and the random finger: calibrated on a wall, biased to the near side of a step, described approximately."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from pretouch_simulation.finger import Finger, FingerModel, measure_scan, realise
from pretouch_simulation.fingers import cone, random
from pretouch_simulation.fingers.cone_finger import ConeFinger
from pretouch_simulation.fingers.cone_response import CALIBRATED_AT, ConeResponse, Estimator, Reflectances
from pretouch_simulation.fingers.range_curve import RangeCurve
from pretouch_simulation.fingers.spot import Profile, Spot
from pretouch_simulation.fingers.status import Status
from pretouch_simulation.objects import box
from pretouch_simulation.world import Body, World

from pretouch.geometry import Plane, Pose
from pretouch.tof import Sensor

FLOOR = World([], Plane(np.array([0.0, 0.0, 1.0]), 0.0))
STEP = World([Body(box(0.1, 0.1, 0.03), Pose.of(np.eye(3), [-0.05, 0.0, 0.0]))], FLOOR.table)
"""Level at 3 cm where x < 0, at 0 elsewhere."""
HALF_ANGLE = np.radians(12.5)
SEEDS = range(60)
WHITE = Reflectances()


def looking_down(height: float, n: int = 1, x: float = 0.0) -> np.ndarray:
    poses = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (n, 1, 1))
    poses[:, :3, 3] = [x, 0.0, height]
    return poses


def random_finger(seed: int) -> ConeFinger:
    return random.draw(np.random.default_rng(seed))


def cone_finger(seed: int) -> ConeFinger:
    return cone.draw(np.random.default_rng(seed))


def stated(sensor: Sensor) -> tuple[float, ...]:
    return sensor.range_min, sensor.range_max, sensor.range_std, sensor.beam_half_angle, sensor.rate


def parameters(finger: Finger) -> tuple[object, ...]:
    assert isinstance(finger, ConeFinger)
    return stated(finger.sensor), finger.response, finger.errors, finger.reflectances


def unfailing(finger: ConeFinger) -> ConeFinger:
    """The finger on bright things, without misses and outliers."""
    return replace(finger, reflectances=WHITE, errors=replace(finger.errors, flagged=0.0, outliers=0.0))


@pytest.mark.parametrize("estimator", list(Estimator))
@pytest.mark.parametrize("profile", list(Profile))
@pytest.mark.parametrize("nearness", [np.inf, 0.003])
def test_a_wall_at_the_calibrations_distance_reads_it(estimator: Estimator, profile: Profile, nearness: float) -> None:
    response = ConeResponse(Spot(HALF_ANGLE, profile, (0.03, -0.02)), nearness, estimator)
    ranges, signal = response.read(FLOOR, looking_down(CALIBRATED_AT), WHITE)
    assert ranges[0] == pytest.approx(CALIBRATED_AT, abs=1e-6)
    assert signal[0] == pytest.approx(1.0, rel=1e-5)


@pytest.mark.parametrize("draw", [cone_finger, random_finger])
def test_a_drawn_finger_reads_a_wall_at_five_centimetres_within_its_bias(draw: Callable[[int], ConeFinger]) -> None:
    for seed in range(20):
        finger = unfailing(draw(seed))
        rng = np.random.default_rng(100 + seed)
        scans = [measure_scan(finger, FLOOR, looking_down(0.05, 400), rng) for _ in range(3)]
        assert all((status == Status.OK).all() for _, status in scans)
        means = [ranges.mean() for ranges, _ in scans]
        scatter = np.hypot(finger.errors.bias, finger.errors.noise / np.sqrt(400))
        assert np.abs(np.array(means) - 0.05).max() < 4 * scatter + finger.errors.step / 2


def test_nearness_pulls_a_reading_over_a_step_to_the_near_side() -> None:
    over_step = looking_down(0.07, x=0.004)
    read = [
        ConeResponse(Spot(HALF_ANGLE), nearness).read(STEP, over_step, WHITE)[0][0]
        for nearness in (np.inf, 0.03, 0.014, 0.007, 0.003)
    ]
    assert (np.diff(read) < -0.0002).all()
    assert read[0] > 0.05
    assert read[-1] == pytest.approx(0.04, abs=0.003)


def test_a_wider_spot_meets_the_step_from_further_away() -> None:
    beside = looking_down(0.07, x=0.012)
    narrow, wide = (ConeResponse(Spot(angle), 0.01).read(STEP, beside, WHITE)[0][0] for angle in np.radians([5, 15]))
    assert narrow == pytest.approx(0.07, abs=0.001)
    assert wide < 0.055


def test_peaks_take_one_level_of_a_step_where_the_mean_takes_both() -> None:
    over_step = looking_down(0.07, x=0.004)

    def read(estimator: Estimator, reflectances: Reflectances = WHITE) -> float:
        response = ConeResponse(Spot(HALF_ANGLE), np.inf, estimator, pulse=0.004)
        return float(response.read(STEP, over_step, reflectances)[0][0])

    assert 0.045 < read(Estimator.MEAN) < 0.065
    assert read(Estimator.FIRST_PEAK) == pytest.approx(0.04, abs=0.002)
    dark_box = Reflectances(table=1.0, bodies=(0.3,))
    assert read(Estimator.STRONGEST_PEAK, dark_box) == pytest.approx(0.07, abs=0.002)


def test_a_turned_boresight_looks_past_an_edge_that_the_stated_beam_would_meet() -> None:
    before_edge = looking_down(0.07, x=-0.001)
    straight, turned, back = (
        ConeResponse(Spot(0.0, boresight=(0.0, turn)), np.inf).read(STEP, before_edge, WHITE)[0][0]
        for turn in (0.0, 0.05, -0.05)
    )
    assert straight == pytest.approx(0.04, abs=1e-4)
    assert back == pytest.approx(0.04, abs=1e-4)
    assert turned == pytest.approx(0.07, abs=1e-4)


def test_all_ranges_of_a_scan_share_a_bias_that_the_next_scan_does_not() -> None:
    finger = unfailing(cone_finger(0))
    rng = np.random.default_rng(4)
    scans = np.array([measure_scan(finger, FLOOR, looking_down(0.05, 300), rng)[0] for _ in range(60)])
    halves = scans[:, :150].mean(axis=1), scans[:, 150:].mean(axis=1)
    assert np.corrcoef(*halves)[0, 1] > 0.9
    assert scans.mean(axis=1).std() == pytest.approx(finger.errors.bias, rel=0.3)
    assert scans.std(axis=1).mean() == pytest.approx(finger.errors.noise, rel=0.1)


def test_a_dark_target_returns_less() -> None:
    def returned(reflectance: float) -> float:
        finger = replace(cone_finger(1), reflectances=Reflectances(table=reflectance))
        ranges, status = measure_scan(finger, FLOOR, looking_down(0.08, 500), np.random.default_rng(0))
        assert np.isnan(ranges[status != Status.OK]).all()
        if reflectance < 0.1:
            assert (status[np.isnan(ranges)] == Status.NO_TARGET).all()
        return float(np.isfinite(ranges).mean())

    assert returned(1.0) > 0.97
    assert returned(0.05) < 0.01


def test_a_dark_thing_in_the_spot_counts_less() -> None:
    response, over_step = ConeResponse(Spot(HALF_ANGLE), np.inf), looking_down(0.07, x=0.004)
    bright, dark = (response.read(STEP, over_step, Reflectances(bodies=(share,)))[0][0] for share in (1.0, 0.2))
    assert dark > bright + 0.003


def test_more_bodies_than_reflectances_take_them_over_again() -> None:
    bodies = np.array([-1, 0, 1, 2])
    np.testing.assert_array_equal(Reflectances(0.5, (0.9, 0.2)).of(bodies), [0.5, 0.9, 0.2, 0.9])


def test_too_near_underflows() -> None:
    finger = unfailing(random_finger(3))
    near = looking_down(finger.errors.least_range - 0.003, 200)
    ranges, status = measure_scan(finger, FLOOR, near, np.random.default_rng(0))
    assert (status == Status.RANGE_UNDERFLOW).all()
    assert np.isnan(ranges).all()


def test_flags_and_outliers_come_as_often_as_they_should() -> None:
    finger = cone_finger(2)
    finger = replace(finger, reflectances=WHITE, errors=replace(finger.errors, flagged=0.03, outliers=0.05))
    ranges, status = measure_scan(finger, FLOOR, looking_down(0.04, 20_000), np.random.default_rng(5))
    flagged = np.isin(status, [Status.SNR, Status.EARLY_CONVERGENCE])
    assert flagged.mean() == pytest.approx(0.03, abs=0.005)
    assert set(status[flagged]) == {Status.SNR, Status.EARLY_CONVERGENCE}
    far_off = (status == Status.OK) & (np.abs(ranges - 0.04) > 0.015)
    assert far_off.mean() == pytest.approx(0.05 * 6 / 9, abs=0.007)


def test_random_fingers_differ_and_state_only_what_a_user_knows() -> None:
    fingers = [random_finger(seed) for seed in SEEDS]
    assert len({finger.response for finger in fingers}) == len(fingers)
    assert len({finger.errors for finger in fingers}) == len(fingers)
    thin = [finger for finger in fingers if finger.response.spot.half_angle == 0]
    assert 5 < len(thin) < 30
    assert all(finger.sensor.beam_half_angle == 0 for finger in thin)
    cones = [finger for finger in fingers if finger.response.spot.half_angle > 0]
    over_stated = [finger.response.spot.half_angle / finger.sensor.beam_half_angle for finger in cones]
    assert 0.8 <= min(over_stated) < 0.9
    assert 1.1 < max(over_stated) <= 1.25
    noises = [finger.sensor.range_std / finger.errors.noise for finger in fingers]
    assert 1 / 1.5 <= min(noises) < 0.9 < 1.1 < max(noises) <= 1.5
    assert all(0 <= finger.sensor.range_min - finger.errors.least_range <= 0.001 for finger in fingers)
    assert {finger.response.estimator for finger in cones} == set(Estimator)
    assert {finger.errors.step for finger in fingers} == {0.0, 0.001}


def test_cones_state_the_same_and_differ() -> None:
    fingers = [cone_finger(seed) for seed in SEEDS]
    assert {stated(finger.sensor) for finger in fingers} == {stated(cone.SENSOR)}
    assert {finger.response.estimator for finger in fingers} == set(Estimator)
    assert len({finger.response for finger in fingers}) == len(fingers)


@pytest.mark.parametrize("model", [FingerModel.CONE, FingerModel.RANDOM])
def test_the_same_seed_realises_the_same_finger(model: FingerModel) -> None:
    first, again, other = (realise(model, np.random.default_rng(seed)) for seed in (9, 9, 10))
    assert parameters(first) == parameters(again)
    assert parameters(first) != parameters(other)


@pytest.mark.parametrize("model", [FingerModel.IDEAL, FingerModel.VL6180X])
def test_ideal_and_vl6180x_are_one_finger_each_and_take_nothing_of_the_generator(model: FingerModel) -> None:
    rng = np.random.default_rng(0)
    before = rng.bit_generator.state
    first, again = realise(model, rng), realise(model, np.random.default_rng(1))
    assert rng.bit_generator.state == before
    assert type(first) is type(again)
    assert stated(first.sensor) == stated(again.sensor)


def test_a_curve_is_zero_at_the_calibrations_distance_and_has_its_stated_bend() -> None:
    span = (0.02, 0.10)
    ranges = np.linspace(*span, 2001)
    curve = RangeCurve(span, gain=0.01, bend=(0.0006, 0.0, 0.0008))
    errors = curve(ranges)
    assert curve(np.array([CALIBRATED_AT]))[0] == 0.0
    bend = errors - np.polynomial.Polynomial.fit(ranges, errors, 1)(ranges)
    assert bend.std() == pytest.approx(0.001, rel=0.01)
    outside = RangeCurve(span, bend=(0.0006,))(np.array([0.005, 0.02]))
    assert outside[0] == outside[1]
