"""Fingertips of several modules: where their modules look, and what they share."""

import numpy as np
import pytest
from pretouch_simulation.finger import FingerModel, measure_scan, realise
from pretouch_simulation.fingers import gripper, zones
from pretouch_simulation.scanning import scan_along
from pretouch_simulation.world import World

from pretouch.geometry import Plane
from pretouch.tof import MAX_SAMPLES
from pretouch.trajectory import Trajectory

FLOOR = World([], Plane(np.array([0.0, 0.0, 1.0]), 0.0))
SEVERAL = [FingerModel.GRIPPER, FingerModel.ZONES]


def hover(height: float, duration: float) -> Trajectory:
    poses = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (2, 1, 1))
    poses[:, 0, 3], poses[:, 2, 3] = (0.0, 0.05 * duration), height
    return Trajectory(np.array([0.0, duration]), poses)


@pytest.mark.parametrize("model", SEVERAL)
def test_every_module_samples_at_its_rate_and_a_long_scan_fits(model: FingerModel) -> None:
    finger = realise(model, np.random.default_rng(0))
    sensor = finger.sensor
    samples = scan_along(FLOOR, hover(0.05, 20.0), sensor, finger, np.random.default_rng(0))
    assert len(samples) == (20 * sensor.rate + 1) * len(sensor.tip_T_module) <= MAX_SAMPLES
    assert set(np.bincount(samples.module)) == {20 * sensor.rate + 1}
    assert len(samples.beams(sensor)) == len(samples)


def test_the_gripper_looks_ahead_aslant_and_sideways() -> None:
    axes = np.stack([pose.rotation[:, 2] for pose in gripper.SENSOR.tip_T_module])
    np.testing.assert_allclose(axes[:2], [[0, 0, 1]] * 2, atol=1e-12)
    half = np.sqrt(0.5)
    np.testing.assert_allclose(axes[2:5], [[0, -half, half], [0, half, half], [-half, 0, half]], atol=1e-12)
    np.testing.assert_allclose(axes[5], [1, 0, 0], atol=1e-12)


def test_zones_look_into_a_square_of_45_degrees() -> None:
    axes = np.stack([pose.rotation[:, 2] for pose in zones.SENSOR.tip_T_module])
    x, y = np.degrees(np.arctan2(axes[:, 0], axes[:, 2])), np.degrees(np.arctan2(axes[:, 1], axes[:, 2]))
    assert x.max() == pytest.approx(22.5 - 2.8125)
    assert np.abs(y).max() < 22.5
    assert len(np.unique(axes.round(6), axis=0)) == 64


def test_zones_measure_along_their_beams_and_share_the_errors_of_frame_and_scan() -> None:
    finger = zones.draw(np.random.default_rng(0))
    poses = hover(0.08, 1.0).sampled(15).base_T_tip
    modules = np.stack([pose.matrix for pose in finger.sensor.tip_T_module])
    places = (poses[:, None] @ modules).reshape(-1, 4, 4)
    expected = 0.08 / -places[:, 2, 2]
    errors = np.stack([
        measure_scan(finger, FLOOR, places, np.random.default_rng(k))[0] - expected for k in range(30)
    ]).reshape(30, len(poses), 64)  # fmt: skip
    of_scan = np.nanmean(errors, axis=(1, 2))
    assert of_scan.std() == pytest.approx(zones.SCAN_BIAS, rel=0.5)
    of_frame = np.nanmean(errors, axis=2) - of_scan[:, None]
    assert of_frame.std() > 1.5 * zones.NOISE / np.sqrt(64)
