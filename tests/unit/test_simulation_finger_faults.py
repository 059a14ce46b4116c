"""Broken fingers report what their fault implies, and are still described as sound ones."""

from collections.abc import Callable

import numpy as np
import pytest
from pretouch_simulation.finger import Finger, FingerModel, measure_scan, realise
from pretouch_simulation.fingers.faults import (
    make_dead_finger,
    make_millimetre_finger,
    make_noise_finger,
    make_stuck_finger,
    make_stuck_module,
)
from pretouch_simulation.fingers.status import Status
from pretouch_simulation.scanning import scan_along
from pretouch_simulation.world import World

from pretouch.geometry import Plane
from pretouch.trajectory import Trajectory

FLOOR = World([], Plane(np.array([0.0, 0.0, 1.0]), 0.0))
SOUND = realise(FingerModel.IDEAL, np.random.default_rng(0))
POSES = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (2000, 1, 1))
POSES[:, 2, 3] = 0.05


def measured(finger: Finger) -> tuple[np.ndarray, np.ndarray]:
    return measure_scan(finger, FLOOR, POSES, np.random.default_rng(3))


@pytest.mark.parametrize("fault", [make_stuck_finger, make_dead_finger, make_noise_finger, make_millimetre_finger])
def test_a_broken_finger_states_the_sound_ones_sensor(fault: Callable[[Finger], Finger]) -> None:
    assert fault(SOUND).sensor == SOUND.sensor


def test_a_stuck_finger_always_reports_the_same_even_where_nothing_is() -> None:
    nothing = World([], Plane(np.array([0.0, 0.0, 1.0]), -5.0))
    ranges, status = measure_scan(make_stuck_finger(SOUND, at=0.04), nothing, POSES, np.random.default_rng(0))
    assert (ranges == 0.04).all()
    assert (status == Status.OK).all()


def test_a_dead_finger_reports_nothing() -> None:
    ranges, status = measured(make_dead_finger(SOUND))
    assert np.isnan(ranges).all()
    assert (status != Status.OK).all()


def test_noise_fills_the_range_evenly() -> None:
    ranges, status = measured(make_noise_finger(SOUND))
    assert (status == Status.OK).all()
    assert ranges.min() >= SOUND.sensor.range_min
    assert ranges.max() <= SOUND.sensor.range_max
    counts, _ = np.histogram(ranges, 4, (SOUND.sensor.range_min, SOUND.sensor.range_max))
    assert counts.min() > 400


def test_millimetres_are_a_thousand_times_too_many() -> None:
    ranges, _ = measured(make_millimetre_finger(SOUND))
    np.testing.assert_array_equal(ranges, 1000 * measured(SOUND)[0])


def test_of_six_modules_only_the_last_is_stuck() -> None:
    finger = make_stuck_module(SOUND, at=0.03)
    path = Trajectory(np.array([0.0, 2.0]), POSES[:2])
    samples = scan_along(FLOOR, path, finger.sensor, finger, np.random.default_rng(1))
    assert len(finger.sensor.tip_T_module) == 6
    bad = samples.module == 5
    assert (samples.range[bad] == 0.03).all()
    for module in range(5):
        assert samples.range[samples.module == module].mean() == pytest.approx(0.05, abs=0.001)
    across = samples.beams(finger.sensor).origins[:6, 0]
    np.testing.assert_allclose(np.diff(across), 0.008, atol=1e-12)
