"""Modules that measure nothing are diagnosed, with the numbers; working ones are not."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from helpers.scenes import Box, World
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from pretouch_orchestrator.perception.sensor_check import Diagnosis, Fault, diagnose, drop_modules, summarize

from pretouch.estimate import Estimate, from_prior
from pretouch.geometry import Pose
from pretouch.prior import Prior
from pretouch.scene import Scene
from pretouch.tof import RangeSamples, Sensor

N = 120
FLAT = World((Box.standing((0.20, 0.20, 0.05), (0.0, 0.0), 0.0),))
"""A top that a path of 8 cm stays on wherever the camera may be wrong."""
SMALL = World((Box.standing((0.05, 0.05, 0.04), (0.0, 0.0), 0.0),))
THIN = Sensor()

FLAT_SCENE, SMALL_SCENE = FLAT.scene(), SMALL.scene()
BEFORE = {id(scene): from_prior(Prior(), scene.cloud) for scene in (FLAT_SCENE, SMALL_SCENE)}


def tips(length: float, height: float) -> NDArray[np.float64]:
    """(N, 4, 4): straight across the objects' middle, beams down, `height` m above the table."""
    poses = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (N, 1, 1))
    poses[:, 0, 3] = np.linspace(-length / 2, length / 2, N)
    poses[:, 2, 3] = height
    return poses


def samples(
    poses: NDArray[np.float64],
    ranges: NDArray[np.float64] | float,
    module: NDArray[np.int64] | int = 0,
    status: int = 0,
) -> RangeSamples:
    n = len(poses)
    return RangeSamples(
        np.arange(n) / 30,
        poses,
        np.broadcast_to(np.asarray(ranges, dtype=float), n),
        np.full(n, status),
        np.broadcast_to(np.asarray(module), n),
    )


def true_ranges(world: World, poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,), m, along the beams; beyond the sensor's range too."""
    return np.asarray(world.cast(poses[:, :3, 3], poses[:, :3, 2])[0], dtype=np.float64)


def faults(scan: RangeSamples, scene: Scene, sensor: Sensor = THIN, estimate: Estimate | None = None) -> list[Fault]:
    diagnoses = diagnose(scan, sensor, scene, estimate or BEFORE[id(scene)])
    for diagnosis in diagnoses:
        assert diagnosis.text.endswith(".")
        assert re.search(r"\d", diagnosis.text)
    return [diagnosis.fault for diagnosis in diagnoses]


ACROSS = tips(0.16, 0.09)
LEVEL = tips(0.08, 0.11)


@given(at=st.floats(0.011, 0.06), garbled=st.integers(0, 5), seed=st.integers(0, 99))
@settings(max_examples=12, deadline=None)
def test_one_range_across_an_object_and_the_table_beside_it_is_stuck(at: float, garbled: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    ranges = at + rng.uniform(-0.0005, 0.0005, N)
    ranges[rng.choice(N, garbled, replace=False)] = rng.uniform(0.01, 0.1, garbled)
    assert faults(samples(ACROSS, ranges), SMALL_SCENE) == [Fault.STUCK]


@given(shift=st.tuples(*[st.floats(-0.02, 0.02)] * 3), seed=st.integers(0, 99), step=st.sampled_from([0.0, 0.001]))
@settings(max_examples=12, deadline=None)
def test_a_constant_range_over_a_flat_top_is_no_contradiction(
    shift: tuple[float, float, float], seed: int, step: float
) -> None:
    world = FLAT.moved(Pose.from_rotation_vector([0.0, 0.0, 0.0], shift))
    ranges = true_ranges(world, LEVEL) + 0.00025 * np.random.default_rng(seed).standard_normal(N)
    if step:
        ranges = np.round(ranges / step) * step
    assert np.ptp(np.quantile(ranges, (0.05, 0.95))) <= 0.0011
    assert faults(samples(LEVEL, ranges), FLAT_SCENE) == []


def test_a_constant_range_far_from_anything_expected_is_stuck_over_a_flat_top_too() -> None:
    sure = from_prior(Prior(0.001, 0.01), FLAT_SCENE.cloud)
    assert faults(samples(LEVEL, 0.03), FLAT_SCENE, estimate=sure) == [Fault.STUCK]
    assert faults(samples(LEVEL, 0.055), FLAT_SCENE, estimate=sure) == []


def test_a_constant_range_after_a_scan_that_measured_nothing_is_stuck_without_more_ado() -> None:
    before = BEFORE[id(FLAT_SCENE)]
    assert faults(samples(LEVEL, 0.06), FLAT_SCENE, estimate=before) == []
    doubted = replace(before, sensor_problem="The sensor is stuck.")
    assert faults(samples(LEVEL, 0.06), FLAT_SCENE, estimate=doubted) == [Fault.STUCK]
    varied = 0.06 + 0.0015 * np.random.default_rng(0).standard_normal(N)
    assert faults(samples(LEVEL, varied), FLAT_SCENE, estimate=doubted) == []


def test_a_module_that_reports_nothing_beside_the_object_is_not_stuck_over_its_top() -> None:
    ranges = np.where(true_ranges(SMALL, ACROSS) < 0.06, 0.05, np.nan)
    assert faults(samples(ACROSS, ranges), SMALL_SCENE) == []


@given(seed=st.integers(0, 999))
@settings(max_examples=10, deadline=None)
def test_ranges_all_over_the_sensors_are_noise(seed: int) -> None:
    ranges = np.random.default_rng(seed).uniform(THIN.range_min, THIN.range_max, N)
    assert faults(samples(ACROSS, ranges), SMALL_SCENE) == [Fault.NOISE]


@given(
    std=st.floats(0.0001, 0.004),
    shift=st.tuples(*[st.floats(-0.015, 0.015)] * 3),
    outliers=st.integers(0, 6),
    half_angle=st.sampled_from([0.0, 0.2]),
    seed=st.integers(0, 99),
)
@settings(max_examples=15, deadline=None)
def test_a_module_that_measures_is_believed(
    std: float, shift: tuple[float, float, float], outliers: int, half_angle: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    world = SMALL.moved(Pose.from_rotation_vector([0.03, -0.02, 0.05], shift))
    ranges = np.maximum(true_ranges(world, ACROSS) + std * rng.standard_normal(N), THIN.range_min)
    ranges[rng.choice(N, outliers, replace=False)] = rng.uniform(0.01, 0.1, outliers)
    sensor = Sensor(beam_half_angle=half_angle)
    assert faults(samples(ACROSS, ranges), SMALL_SCENE, sensor) == []
    unreturned = np.where(ranges > sensor.range_max, np.nan, ranges)
    assert faults(samples(ACROSS, unreturned), SMALL_SCENE, sensor) == []


@pytest.mark.parametrize(
    ("unit", "said"),
    [
        (1000.0, "divided by 1000"),
        (100.0, "divided by 100"),
        (10.0, "divided by 10"),
        (0.001, "multiplied by 1000"),
    ],
)
def test_another_unit_is_named_by_its_factor(unit: float, said: str) -> None:
    ranges = unit * (true_ranges(FLAT, LEVEL) + 0.0015 * np.random.default_rng(0).standard_normal(N))
    (diagnosis,) = diagnose(samples(LEVEL, ranges), THIN, FLAT_SCENE, BEFORE[id(FLAT_SCENE)])
    assert diagnosis.fault is Fault.UNIT
    assert f"{said} " in diagnosis.text
    assert "send metres" in diagnosis.text


def test_a_code_for_no_target_is_no_unit() -> None:
    high = tips(0.08, 0.3)
    codes = np.where(np.arange(N) % 2, 8.190, 8.191)
    assert faults(samples(high, codes), FLAT_SCENE) == []


def test_readings_beyond_the_stated_range_that_are_as_expected_are_no_unit() -> None:
    high = tips(0.08, 0.25)
    assert faults(samples(high, true_ranges(FLAT, high)), FLAT_SCENE) == []


@pytest.mark.parametrize(("reading", "status"), [(np.nan, 7), (0.05, 4), (0.0, 0), (0.255, 0)])
def test_no_range_from_where_there_should_be_some_is_dead(reading: float, status: int) -> None:
    assert faults(samples(LEVEL, reading, status=status), FLAT_SCENE) == [Fault.DEAD]


@pytest.mark.parametrize("height", [0.13, 0.3])
def test_no_range_from_where_the_surface_may_be_out_of_range_is_none(height: float) -> None:
    assert faults(samples(tips(0.08, height), np.nan, status=7), FLAT_SCENE) == []


def test_scans_that_could_each_be_out_of_range_are_not_all_so() -> None:
    height = next(
        height
        for height in np.arange(0.11, 0.14, 0.001)
        if not faults(samples(tips(0.012, height), np.nan, status=7), FLAT_SCENE)
    )
    scan = samples(tips(0.012, height - 0.001)[:12], np.nan, status=7)
    estimate, earlier = BEFORE[id(FLAT_SCENE)], scan.beams(THIN)
    assert diagnose(scan, THIN, FLAT_SCENE, estimate) == ()
    assert [diagnosis.fault for diagnosis in diagnose(scan, THIN, FLAT_SCENE, estimate, [earlier])] == [Fault.DEAD]
    returned = samples(LEVEL, 0.06).beams(THIN)
    assert diagnose(scan, THIN, FLAT_SCENE, estimate, [earlier, returned]) == ()


@pytest.mark.parametrize("n", [0, 1, 19])
def test_few_samples_tell_nothing(n: int) -> None:
    for reading in (0.03, np.nan):
        assert faults(samples(ACROSS[:n], reading), SMALL_SCENE) == []


def test_of_six_modules_the_stuck_one_is_named_and_left_out() -> None:
    spread = tuple(Pose.of(np.eye(3), [0.0, 0.004 * k, 0.0]) for k in range(6))
    poses, module = np.repeat(ACROSS, 6, axis=0), np.tile(np.arange(6), N)
    noise = 0.0015 * np.random.default_rng(1).standard_normal(6 * N)
    ranges = np.where(module == 3, 0.03, np.repeat(true_ranges(SMALL, ACROSS), 6) + noise)
    scan = samples(poses, ranges, module)
    (diagnosis,) = diagnose(scan, Sensor(tip_T_module=spread), SMALL_SCENE, BEFORE[id(SMALL_SCENE)])
    assert (diagnosis.module, diagnosis.fault) == (3, Fault.STUCK)
    assert diagnosis.text.startswith("Module 3 reads 30.0 mm in 120 of 120 samples while the surface ")
    assert diagnosis.text.endswith(" varies by 40 mm: it is stuck.")
    left = drop_modules(scan, [diagnosis.module])
    assert sorted(set(left.module.tolist())) == [0, 1, 2, 4, 5]
    np.testing.assert_array_equal(left.range, ranges[module != 3])
    assert diagnose(left, Sensor(tip_T_module=spread), SMALL_SCENE, BEFORE[id(SMALL_SCENE)]) == ()


def test_many_bad_modules_are_told_of_briefly() -> None:
    diagnoses = [Diagnosis(k, Fault.DEAD, f"Module {k} is dead.") for k in range(6)]
    assert summarize(diagnoses[:2]) == "Module 0 is dead. Module 1 is dead."
    assert summarize(diagnoses) == (
        "Module 0 is dead. Module 1 is dead. Module 2 is dead. 3 more modules measure nothing either."
    )


@pytest.mark.parametrize("noise", [0.0, 0.001, 0.002])
def test_a_module_that_sees_only_the_other_finger_is_named_and_the_others_are_kept(noise: float) -> None:
    sensor = Sensor(
        range_std=0.002, tip_T_module=(Pose.identity(), Pose.from_rotation_vector([0.0, np.pi / 2, 0.0], np.zeros(3)))
    )
    poses = tips(0.12, 0.09)
    rng = np.random.default_rng(0)
    down = samples(poses, true_ranges(SMALL, poses) + 0.002 * rng.standard_normal(N))
    ranges = np.stack([np.where(down.range <= 0.1, down.range, np.nan), 0.015 + noise * rng.standard_normal(N)], axis=1)
    both = samples(np.repeat(poses, 2, axis=0), ranges.ravel(), np.tile([0, 1], N))
    (diagnosis,) = diagnose(both, sensor, SMALL_SCENE, BEFORE[id(SMALL_SCENE)])
    assert diagnosis.module == 1
    assert diagnosis.fault in (Fault.ROBOT, Fault.STUCK)
    assert (noise == 0.0) == (diagnosis.fault is Fault.STUCK)
    assert "Module 1 reads 15" in diagnosis.text
    assert set(drop_modules(both, [1]).module) == {0}


def test_a_sideways_module_along_a_wall_is_not_taken_for_one_that_sees_the_robot() -> None:
    sensor = Sensor(tip_T_module=(Pose.from_rotation_vector([-np.pi / 2, 0.0, 0.0], np.zeros(3)),))
    poses = tips(0.08, 0.03)
    poses[:, 1, 3] = 0.13
    ranges = 0.03 + 0.0015 * np.random.default_rng(0).standard_normal(N)
    turned = poses @ sensor.tip_T_module[0].matrix
    assert true_ranges(FLAT, turned) == pytest.approx(0.03, abs=1e-9)
    assert faults(samples(poses, ranges), FLAT_SCENE, sensor) == []
