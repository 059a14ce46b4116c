"""Scans in simulated time: as planned, and guarded by the robot's reflex."""

from __future__ import annotations

import numpy as np
import pytest
from pretouch_simulation.finger import Finger, FingerModel, measure_scan, realise
from pretouch_simulation.fingers.faults import make_dead_finger, make_noise_finger, make_stuck_module
from pretouch_simulation.fingers.several import side_by_side
from pretouch_simulation.objects import box
from pretouch_simulation.scanning import fly_guarded, scan_along
from pretouch_simulation.world import Body, World

from pretouch.client import Reflex
from pretouch.geometry import Plane, Pose
from pretouch.trajectory import Trajectory

TABLE = Plane(np.array([0.0, 0.0, 1.0]), 0.0)
IDEAL = realise(FingerModel.IDEAL, np.random.default_rng(0))
FINGERS = {
    **{model.value: realise(model, np.random.default_rng(4)) for model in FingerModel},
    "three modules": side_by_side([realise(FingerModel.VL6180X, np.random.default_rng(0))] * 3, 0.008),
    "one of six stuck": make_stuck_module(IDEAL),
}
every_finger = pytest.mark.parametrize("finger", FINGERS.values(), ids=FINGERS)


def level_path(height: float, seconds: float = 4.0) -> Trajectory:
    """Along x from -10 cm at 5 cm/s, the beam straight down, at `height` above the table."""
    ends = [Pose.of(np.diag([1.0, -1.0, -1.0]), [x, 0.0, height]).matrix for x in (-0.1, -0.1 + 0.05 * seconds)]
    return Trajectory(np.array([0.0, seconds]), np.stack(ends))


def world_of(height: float, slope: float) -> World:
    """A plate, tilted about y, whose top crosses x = 0 at `height`, m, above the table and rises with x by `slope`."""
    tilted = Pose.from_rotation_vector([0.0, -np.arctan(slope), 0.0], [0.0, 0.0, height])
    plate = Body(box(0.6, 0.6, 0.001), tilted @ Pose.from_rotation_vector([0, 0, 0], [0, 0, -0.001]))
    return World([plate], TABLE)


def clearances(world: World, base_T_tip: np.ndarray) -> np.ndarray:
    """m along the beams from well above down to the world, less the way to the tips."""
    up = -base_T_tip[:, :3, 2]
    return world.cast(base_T_tip[:, :3, 3] + 0.3 * up, -up) - 0.3


@every_finger
def test_a_scan_is_the_same_measured_step_by_step(finger: Finger) -> None:
    poses = np.repeat(level_path(0.04).sampled(30.0).base_T_tip, 3, axis=0)[:90]
    world = world_of(0.0, 0.3)
    whole = measure_scan(finger, world, poses, np.random.default_rng(1))
    measurements = finger.begin_scan(len(poses), np.random.default_rng(1))
    pieces = [measurements.take(world, poses[k : k + 7], k) for k in range(0, len(poses), 7)]
    for at_once, parts in zip(whole, zip(*pieces, strict=True), strict=True):
        np.testing.assert_array_equal(at_once, np.concatenate(parts))


@every_finger
@pytest.mark.parametrize("seed", range(3))
def test_a_guarded_tip_rises_over_what_the_plan_did_not_expect(finger: Finger, seed: int) -> None:
    world, path = world_of(0.02, 0.5), level_path(0.04)
    assert clearances(world, path.sampled(30.0).base_T_tip).min() < -0.02
    descent, samples = fly_guarded(world, path, finger.sensor, finger, np.random.default_rng(seed), Reflex())
    assert clearances(world, np.concatenate([descent, samples.base_T_tip])).min() > 0.003
    lifted = samples.base_T_tip[:, 2, 3] - 0.04
    assert lifted.min() >= 0
    np.testing.assert_allclose(
        samples.base_T_tip[:, 0, 3],
        scan_along(world, path, finger.sensor, finger, np.random.default_rng(seed)).base_T_tip[:, 0, 3],
        atol=1e-12,
    )


@every_finger
def test_a_guarded_tip_does_not_descend_into_what_stands_at_the_first_waypoint(finger: Finger) -> None:
    world, path = world_of(0.05, 0.0), level_path(0.04, seconds=0.5)
    for seed in range(5):
        flight = fly_guarded(world, path, finger.sensor, finger, np.random.default_rng(seed), Reflex())
        assert clearances(world, np.concatenate([flight[0], flight[1].base_T_tip])).min() > 0.002


@every_finger
def test_where_all_is_as_expected_a_guarded_tip_follows_the_plan(finger: Finger) -> None:
    path = level_path(0.05)
    samples = scan_along(World([], TABLE), path, finger.sensor, finger, np.random.default_rng(2), Reflex())
    planned = np.repeat(path.sampled(finger.sensor.rate).base_T_tip, len(finger.sensor.tip_T_module), axis=0)
    assert np.mean(samples.base_T_tip[:, 2, 3] - planned[:, 2, 3]) < 0.002
    assert np.mean(np.isfinite(samples.range)) > 0.8


def test_a_dead_finger_follows_the_plan_to_its_end() -> None:
    path, finger = level_path(0.05), make_dead_finger(IDEAL)
    samples = scan_along(World([], TABLE), path, finger.sensor, finger, np.random.default_rng(3), Reflex())
    np.testing.assert_allclose(samples.base_T_tip, path.sampled(30.0).base_T_tip, atol=1e-12)


def test_a_noisy_finger_stays_between_the_plan_and_the_limit() -> None:
    path, finger = level_path(0.05), make_noise_finger(IDEAL)
    samples = scan_along(World([], TABLE), path, finger.sensor, finger, np.random.default_rng(3), Reflex())
    heights = samples.base_T_tip[:, 2, 3]
    assert len(samples) == len(path.sampled(30.0).t)
    assert heights.min() >= 0.05
    assert heights.max() <= 0.05 + Reflex().highest
