"""The simulated fingertip has the stated noise, range and status codes."""

import numpy as np
import pytest
from pretouch_simulation.finger import Finger, FingerModel, measure_scan, realise
from pretouch_simulation.fingers import vl6180x
from pretouch_simulation.fingers.status import Status
from pretouch_simulation.objects import box
from pretouch_simulation.world import Body, World

from pretouch.geometry import Plane, Pose
from pretouch.tof import RangeSamples

FLOOR = World([], Plane(np.array([0.0, 0.0, 1.0]), 0.0))


def finger_of(model: FingerModel, seed: int = 0) -> Finger:
    return realise(model, np.random.default_rng(seed))


def looking_down(height: float, n: int, x: float = 0.0) -> np.ndarray:
    poses = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (n, 1, 1))
    poses[:, :3, 3] = [x, 0.0, height]
    return poses


def test_the_ideal_finger_has_its_stated_noise() -> None:
    ranges, status = measure_scan(
        finger_of(FingerModel.IDEAL), FLOOR, looking_down(0.05, 4000), np.random.default_rng(0)
    )
    assert (status == Status.OK).all()
    assert ranges.mean() == pytest.approx(0.05, abs=1e-4)
    assert ranges.std() == pytest.approx(finger_of(FingerModel.IDEAL).sensor.range_std, rel=0.05)


@pytest.mark.parametrize("model", list(FingerModel))
@pytest.mark.parametrize(("height", "code"), [(0.3, Status.NO_TARGET), (0.0005, Status.RANGE_UNDERFLOW)])
def test_beyond_its_range_a_finger_says_so(model: FingerModel, height: float, code: Status) -> None:
    ranges, status = measure_scan(finger_of(model), FLOOR, looking_down(height, 400), np.random.default_rng(1))
    said = status == code
    assert said.mean() > 0.45
    assert np.isnan(ranges[said]).all()


@pytest.mark.parametrize("model", list(FingerModel))
@pytest.mark.parametrize("height", [0.004, 0.011, 0.03, 0.099, 0.102, 0.3])
def test_whatever_a_finger_measures_its_sensor_accepts(model: FingerModel, height: float) -> None:
    poses, finger = looking_down(height, 500), finger_of(model)
    ranges, status = measure_scan(finger, FLOOR, poses, np.random.default_rng(2))
    assert np.array_equal(np.isnan(ranges), status != Status.OK)
    samples = RangeSamples(np.arange(500) / 30, poses, ranges, status, np.zeros(500, dtype=int))
    scan = samples.beams(finger.sensor)
    np.testing.assert_array_equal(scan.returned, status == Status.OK)


@pytest.mark.parametrize("height", [0.02, 0.05, 0.09])
def test_the_cone_reads_the_distance_of_a_perpendicular_wall(height: float) -> None:
    ranges, signal = vl6180x.mean_range(FLOOR, looking_down(height, 1))
    assert ranges[0] == pytest.approx(height, abs=1e-6)
    assert signal[0] == pytest.approx(1 / height**2, rel=1e-5)


def test_the_vl6180x_steps_by_millimetres_and_its_noise_and_bias_grow() -> None:
    rng = np.random.default_rng(3)
    spread, offset = [], []
    for height in (0.02, 0.09):
        ranges, status = measure_scan(finger_of(FingerModel.VL6180X), FLOOR, looking_down(height, 6000), rng)
        good = ranges[status == Status.OK]
        assert np.abs(good * 1000 - np.round(good * 1000)).max() < 1e-9
        inner = good[np.abs(good - height) < 0.01]
        spread.append(inner.std())
        offset.append(inner.mean() - height)
        assert 0.003 < (status != Status.OK).mean() < 0.03
        assert 0.0005 < 1 - len(inner) / len(good) < 0.01
    assert spread[0] < spread[1] < 2.2 * vl6180x.NOISE_AT_MAX
    assert offset[0] < 0.0003 < 0.001 < offset[1] < 0.002


def test_near_an_edge_the_cone_sees_a_mixture_and_the_thin_beam_does_not() -> None:
    world = World([Body(box(0.1, 0.1, 0.04), Pose.identity())], Plane(np.array([0.0, 0.0, 1.0]), 0.0))
    over_edge = looking_down(0.07, 1, x=0.05)
    mixed, _ = vl6180x.mean_range(world, over_edge)
    assert 0.031 < mixed[0] < 0.06
    beside = measure_scan(
        finger_of(FingerModel.IDEAL), world, looking_down(0.07, 1, x=0.052), np.random.default_rng(0)
    )[0]
    assert beside[0] == pytest.approx(0.07, abs=0.006)


def test_the_ideal_finger_and_the_vl6180x_measure_as_they_always_did() -> None:
    poses = looking_down(0.05, 12)
    poses[:, 2, 3] = np.linspace(0.005, 0.105, 12)
    ideal, status = measure_scan(finger_of(FingerModel.IDEAL), FLOOR, poses, np.random.default_rng(6))
    expected = poses[:, 2, 3] + np.random.default_rng(6).normal(0.0, 0.0015, 12)
    np.testing.assert_array_equal(ideal[1:-1], expected[1:-1])
    assert status.tolist() == [Status.RANGE_UNDERFLOW, *[Status.OK] * 10, Status.NO_TARGET]
    real, status = measure_scan(finger_of(FingerModel.VL6180X), FLOOR, poses, np.random.default_rng(6))
    np.testing.assert_allclose(1000 * real, [11, 16, 21, 32, 43, 53, 61, 72, 79, 89, 98, np.nan], atol=1e-9)
    assert status.tolist() == [Status.OK] * 11 + [Status.NO_TARGET]


@pytest.mark.parametrize("model", list(FingerModel))
def test_the_same_seed_measures_the_same(model: FingerModel) -> None:
    first, again = (
        measure_scan(finger_of(model, seed=5), FLOOR, looking_down(0.05, 50), np.random.default_rng(7))
        for _ in range(2)
    )
    np.testing.assert_array_equal(first[0], again[0])
    np.testing.assert_array_equal(first[1], again[1])
