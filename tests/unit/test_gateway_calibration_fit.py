"""The fit recovers modules that are known, from readings as a sensor gives them: noisy, in steps, with outliers."""

from __future__ import annotations

import numpy as np
import pytest
from pretouch_sensor_gateway.calibration.fit import PLACEMENT_STD, fit_module
from pretouch_sensor_gateway.calibration.model import UNCALIBRATED, ModuleCalibration
from pretouch_sensor_gateway.calibration.motion_check import describe_motion
from pretouch_sensor_gateway.calibration.readings import find_step, reject_outliers, split_by_module
from pretouch_sensor_gateway.calibration.record import ModuleFit
from pretouch_sensor_gateway.calibration.table import remarks

from pretouch.geometry import Array

DISTANCES = np.array([15, 20, 30, 40, 50, 60, 80, 100]) / 1000
PLAIN = ModuleCalibration(0.003, 1.02, 0.0, 0.0007, 0.013)
GLASS = ModuleCalibration(-0.012, 0.95, 12.0, 0.0007, 0.013)


def readings_of(
    true: ModuleCalibration,
    seed: int,
    *,
    step: float = 0.001,
    count: int = 60,
    outliers: float = 0.02,
    placement: float = PLACEMENT_STD,
    distances: Array = DISTANCES,
) -> dict[float, Array]:
    """Readings whose noise, calibrated, is that of `true`."""
    rng = np.random.default_rng(seed)
    readings = {}
    for distance in distances:
        r = np.full(count, distance + placement * rng.standard_normal())
        noise = rng.standard_normal(count) * true.std_at(r) / true.gain(r)
        raw = true.predict_reading(r) + noise
        if step:
            raw = np.round(raw / step) * step
        bad = rng.uniform(size=count) < outliers
        raw[bad] = np.round(rng.uniform(0.1, 0.2, bad.sum()), 3) + 0.05
        readings[float(distance)] = raw
    return readings


@pytest.mark.parametrize("true", [PLAIN, GLASS], ids=["plain", "glass"])
@pytest.mark.parametrize("step", [0.0, 0.0001, 0.001])
def test_parameters_come_back_within_their_standard_errors(true: ModuleCalibration, step: float) -> None:
    z = []
    for seed in range(30):
        found = fit_module(readings_of(true, seed, step=step))
        assert not found.problem
        assert found.step == pytest.approx(step)
        errors = found.errors
        assert errors.offset < 0.0005
        assert errors.scale < 0.015
        z.append(
            [
                (found.calibration.offset - true.offset) / errors.offset,
                (found.calibration.scale - true.scale) / errors.scale,
                (found.calibration.std_at(np.array(0.05)) - true.std_at(np.array(0.05))) / 1e-4,
            ]
        )
        if true.crosstalk:
            assert abs(found.calibration.crosstalk - true.crosstalk) < 4 * errors.crosstalk < 8
    rms = np.sqrt(np.mean(np.square(z), axis=0))
    assert (rms < 1.5).all(), rms  # the standard errors are no smaller than the errors
    assert (rms[:2] > 0.4).all(), rms  # and not much larger


def test_crosstalk_is_exactly_none_unless_it_is_significant() -> None:
    found = [fit_module(readings_of(PLAIN, seed)).calibration.crosstalk for seed in range(60)]
    assert sum(crosstalk == 0.0 for crosstalk in found) >= 54  # two standard errors, one side
    assert all(fit_module(readings_of(GLASS, seed)).calibration.crosstalk > 8 for seed in range(20))


def test_calibrated_readings_are_distances() -> None:
    found = fit_module(readings_of(GLASS, 3, placement=0.0))
    for point in found.points:
        assert abs(point.residual) < 0.001
        assert abs(point.mean - point.distance) > 0.01
    off = np.abs(found.calibration.distance(GLASS.predict_reading(DISTANCES)) - DISTANCES)
    assert off.max() < 0.001


def bending(r: Array) -> Array:
    """Readings, m, that saturate near and far, as those of a histogram's bins."""
    return np.asarray(0.9 * r - 0.01 + 0.002 * np.sin(r / 0.02))


@pytest.mark.parametrize("count", [12, 40])
def test_a_curve_that_bends_is_followed_and_its_residual_is_the_error_elsewhere(count: int) -> None:
    ratios = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        r = np.linspace(0.02, 0.15, count)
        found = fit_module({float(x): bending(x) + 0.0005 * rng.standard_normal(30) for x in r}).calibration
        assert found.span == (0.02, 0.15)
        between = np.linspace(0.02, 0.15, 301)
        off = float(np.sqrt(np.mean((found.distance(bending(between)) - between) ** 2)))
        assert off < 0.0006
        ratios.append(off / np.hypot(found.residual, PLACEMENT_STD))
    assert 0.2 < np.sqrt(np.mean(np.square(ratios))) < 1.5, ratios


def test_a_straight_module_keeps_its_line() -> None:
    bent = [bool(fit_module(readings_of(PLAIN, seed)).calibration.corrections) for seed in range(40)]
    assert sum(bent) <= 4


@pytest.mark.parametrize("share", [0.02, 0.2])
def test_outliers_of_good_status_are_counted_and_do_not_matter(share: float) -> None:
    clean, spoilt = (fit_module(readings_of(PLAIN, 5, outliers=part)) for part in (0.0, share))
    count = sum(len(point.outliers) for point in spoilt.points)
    assert sum(point.samples for point in spoilt.points) + count == 60 * len(DISTANCES)
    assert 0.5 * share < count / (60 * len(DISTANCES)) < 2 * share
    assert min(reading for point in spoilt.points for reading in point.outliers) >= 0.15
    assert sum(len(point.outliers) for point in clean.points) == 0
    assert abs(spoilt.calibration.offset - PLAIN.offset) < 4 * spoilt.errors.offset
    assert spoilt.calibration.std_at(np.array(0.05)) < 1.3 * PLAIN.std_at(np.array(0.05))


def test_noise_is_never_taken_for_less_than_rounding_makes() -> None:
    quiet = ModuleCalibration(0.003, 1.0, 0.0, 0.00005, 0.0)
    coarse, fine = (fit_module(readings_of(quiet, 1, step=step)) for step in (0.001, 0.0001))
    assert coarse.calibration.std >= 0.001 / np.sqrt(12)
    assert 0.0001 / np.sqrt(12) <= fine.calibration.std < 0.0001


def test_rounding_that_no_noise_averages_out_makes_errors_larger() -> None:
    quiet = ModuleCalibration(0.0034, 1.01, 0.0, 0.00002, 0.0)
    off = []
    for seed in range(20):
        found = fit_module(readings_of(quiet, seed, step=0.001, distances=DISTANCES + 0.0001 * seed, placement=0.0))
        off.append((found.calibration.offset - quiet.offset) / found.errors.offset)
    assert np.sqrt(np.mean(np.square(off))) < 1.5


def test_readings_without_any_noise_fit_too() -> None:
    found = fit_module({float(r): np.full(20, 0.004 + r) for r in DISTANCES})
    assert found.calibration.offset == pytest.approx(0.004, abs=1e-6)
    assert found.calibration.scale == pytest.approx(1.0, abs=1e-5)
    assert found.calibration.crosstalk == 0
    assert found.calibration.std > 0


def test_a_plate_that_stood_elsewhere_makes_the_errors_larger_and_is_named() -> None:
    good, bad = readings_of(PLAIN, 2), readings_of(PLAIN, 2)
    bad[0.06] = bad[0.06] + 0.008
    right, wrong = fit_module(good), fit_module(bad)
    assert wrong.errors.offset > 3 * right.errors.offset
    assert wrong.calibration.crosstalk == 0
    assert not remarks([right])
    (said,) = remarks([wrong])
    assert "At 60 mm the modules are +" in said


def test_two_distances_tell_no_crosstalk_and_one_no_scale() -> None:
    two = fit_module(readings_of(GLASS, 1, distances=DISTANCES[[1, 6]]))
    assert two.calibration.crosstalk == two.errors.crosstalk == 0
    assert two.errors.scale > 0
    one = fit_module(readings_of(PLAIN, 1, distances=DISTANCES[[1]]))
    assert (one.calibration.scale, one.errors.scale, one.calibration.std_slope) == (1.0, 0.0, 0.0)
    assert one.calibration.offset == pytest.approx(0.003 + 0.02 * 0.02, abs=4 * one.errors.offset)
    assert "two distances tell offset and scale alone" in remarks([two])[0]
    assert "one distance tells the offset alone" in remarks([one])[0]


@pytest.mark.parametrize(
    ("readings", "said"),
    [
        ({}, "too little"),
        ({0.02: np.zeros(0)}, "too little"),
        ({r: np.full(20, 0.1 * r) for r in (0.02, 0.05, 0.1)}, "scale is 0.1"),
        ({r: np.full(20, 5 * r) for r in (0.02, 0.05, 0.1)}, "scale is 5"),
        ({r: np.full(20, 0.5 + r) for r in (0.02, 0.05, 0.1)}, "offset is 0.5"),
        ({r: np.full(20, 0.05) for r in (0.02, 0.05, 0.1)}, "scale is"),
    ],
    ids=["nothing", "empty", "units", "steep", "far", "blind"],
)
def test_a_module_that_makes_no_sense_stays_uncalibrated_and_says_why(readings: dict[float, Array], said: str) -> None:
    found = fit_module(readings)
    assert said in found.problem
    assert found.calibration == UNCALIBRATED
    assert said in remarks([ModuleFit(), found])[-1]


def test_steps_are_seen_where_all_readings_share_one() -> None:
    rng = np.random.default_rng(0)
    whole = rng.integers(15, 200, 50) * 0.002
    assert find_step([whole]) == pytest.approx(0.002)
    assert find_step([whole, np.array([0.0301])]) == pytest.approx(0.0001)
    assert find_step([rng.uniform(0, 0.2, 50)]) == 0
    assert find_step([np.full(9, 0.03)]) == 0


def test_readings_that_nearly_all_agree_make_no_outlier_of_the_next_step() -> None:
    point = reject_outliers(0.02, np.array([0.02] * 55 + [0.021] * 5), 0.001)
    assert (point.samples, point.outliers) == (60, ())


def test_a_module_that_hardly_answers_is_not_used() -> None:
    raw = np.full((60, 3), 0.02)
    raw[15:, 1], raw[14:, 2] = np.nan, np.nan
    assert [len(column) for column in split_by_module(raw)] == [60, 15, 0]
    assert [len(column) for column in split_by_module(raw[:12])] == [12, 12, 12]


def test_a_plate_at_rest_is_hardly_ever_doubted() -> None:
    rng = np.random.default_rng(0)
    for _ in range(1000):
        readings = 0.05 + 0.002 * rng.standard_normal(60)
        readings[rng.uniform(size=60) < 0.03] = 0.18
        assert describe_motion(np.round(readings, 3), [0.0012, 0.0015]) == ""


def test_a_plate_that_moves_is_noticed() -> None:
    rng = np.random.default_rng(0)
    still = 0.05 + 0.0008 * rng.standard_normal(60)
    slides, jumps = np.linspace(0, 0.004, 60), np.where(np.arange(60) < 30, 0.0, 0.005)
    shaken = 0.005 * np.sin(np.arange(60))
    assert describe_motion(still, [0.0008]) == ""
    assert "moved" in describe_motion(still + slides, [])
    assert "moved by 5." in describe_motion(still + jumps, [])
    assert describe_motion(still + shaken, []) == ""  # nothing to compare with yet
    assert "at most 0.8 mm elsewhere" in describe_motion(still + shaken, [0.0008, 0.0007])
