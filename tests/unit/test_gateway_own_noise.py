"""The noise of modules that nobody calibrated, and the jumps that it tells from noise."""

from __future__ import annotations

import numpy as np
import pytest
from pretouch_sensor_gateway.jump_detector import JumpDetector
from pretouch_sensor_gateway.own_noise import LEAST, WINDOW, OwnNoise

RATE = 30.0


@pytest.mark.parametrize("noise", [0.0003, 0.0015, 0.02])
@pytest.mark.parametrize("step", [0.0, 0.001])
def test_it_is_found_while_the_finger_moves_over_edges_and_some_readings_are_wild(noise: float, step: float) -> None:
    found = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        n = np.arange(WINDOW)
        ranges = 0.08 - 0.0015 * n / RATE + 0.03 * (n > 40) + noise * rng.standard_normal(WINDOW)
        ranges = np.where(rng.uniform(size=WINDOW) < 0.02, 0.2, np.round(ranges / step) * step if step else ranges)
        ranges[rng.uniform(size=WINDOW) < 0.1] = np.nan
        found.append(OwnNoise().observe(ranges[:, None])[-1, 0])
    true = np.hypot(noise, step / np.sqrt(12))
    assert 0.75 * true < np.median(found) < 1.35 * true
    assert all(0.5 * true < each < 2 * true for each in found)


def test_it_is_unknown_before_for_each_module_and_for_one_that_never_changes() -> None:
    rng = np.random.default_rng(0)
    ranges = 0.05 + 0.001 * rng.standard_normal((WINDOW, 3))
    ranges[:, 1], ranges[:, 2] = 0.05, np.nan
    found = OwnNoise().observe(ranges)
    assert np.isnan(found[:LEAST]).all()
    assert np.isnan(found[-1]).tolist() == [False, True, True]
    in_parts = OwnNoise()
    np.testing.assert_array_equal(np.concatenate([in_parts.observe(part) for part in np.split(ranges, 8)]), found)


def test_it_starts_over_with_another_device() -> None:
    rng = np.random.default_rng(0)
    noise = OwnNoise()
    assert np.isfinite(noise.observe(0.05 + 0.001 * rng.standard_normal((WINDOW, 1)))[-1]).all()
    assert np.isnan(noise.observe(0.05 + 0.001 * rng.standard_normal((1, 2)))).all()
    noise.observe(0.05 + 0.001 * rng.standard_normal((WINDOW, 2)))
    noise.restart()
    assert np.isnan(noise.observe(np.full((1, 2), 0.05))).all()


@pytest.mark.parametrize("noise", [0.0003, 0.0015, 0.02])
def test_what_a_modules_noise_explains_is_no_jump_and_the_rest_is(noise: float) -> None:
    rng = np.random.default_rng(1)
    detector, jumps = JumpDetector(), []
    for n in range(3000):
        jumps += detector.detect(n / RATE, [0.5 + noise * rng.standard_normal()], [noise])
    assert not any(jumps)
    assert detector.detect(100.0, [0.5 + 14 * noise + 0.002], [noise]) == [True]
    assert detector.detect(100.0 + 1 / RATE, [0.5], [noise]) == [False]


def test_a_slow_sensors_surface_may_move_further_between_two_ranges() -> None:
    for seconds, jumped in ((1 / 30, True), (0.14, False), (1e6, True)):
        detector = JumpDetector()
        detector.detect(0.0, [0.05], [0.0003])
        assert detector.detect(seconds, [0.058 if seconds < 1 else 0.15], [0.0003]) == [jumped]


def test_nothing_is_a_jump_while_the_noise_is_unknown() -> None:
    detector = JumpDetector()
    assert [detector.detect(t, [metres], [np.nan]) for t, metres in ((0.0, 0.05), (0.1, 4.0))] == [[False], [False]]
