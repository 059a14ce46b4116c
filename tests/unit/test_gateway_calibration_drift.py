"""Drift and warm-up are found in noise of known kinds."""

from __future__ import annotations

import numpy as np
import pytest
from pretouch_sensor_gateway.calibration.drift import HORIZON, SCAN, measure_drift

from pretouch.errors import InvalidInput
from pretouch.geometry import Array

RATE = 20.0


def flicker(count: int, rng: np.random.Generator) -> Array:
    """Noise with a density of 1 / f and a standard deviation of about 1."""
    half = count // 2
    spectrum = np.zeros(half + 1, dtype=complex)
    spectrum[1:] = (rng.standard_normal(half) + 1j * rng.standard_normal(half)) / np.sqrt(np.arange(1, half + 1))
    made = np.fft.irfft(spectrum, count)
    return np.asarray(made / made.std())


def test_white_noise_has_no_drift() -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        drift = measure_drift(0.05 + 0.002 * rng.standard_normal(int(600 * RATE)), RATE)
        assert drift.white_std == pytest.approx(0.002, rel=0.05)
        assert drift.found < 0.00015
        assert drift.warm_up == 0


def test_ten_minutes_tell_how_much_the_scans_of_many_hours_differ() -> None:
    stated, true = [], []
    count, each = int(HORIZON * RATE), round(SCAN * RATE)
    for seed in range(6):
        rng = np.random.default_rng(seed)
        slow = 0.0006 * flicker(count, rng)
        true.append(slow.reshape(-1, each).mean(axis=1).var())
        piece = slow[: int(600 * RATE)]
        stated.append(measure_drift(0.05 + piece + 0.002 * rng.standard_normal(len(piece)), RATE).bias_std ** 2)
    assert 0.7 < np.sqrt(np.mean(stated) / np.mean(true)) < 1.4


@pytest.mark.parametrize("tau", [30.0, 90.0])
def test_a_module_that_gets_warm_is_seen_to_and_its_warm_ranges_alone_count(tau: float) -> None:
    t = np.arange(int(900 * RATE)) / RATE
    for seed in range(5):
        rng = np.random.default_rng(seed)
        drift = measure_drift(0.05 + 0.004 * np.exp(-t / tau) + 0.001 * rng.standard_normal(len(t)), RATE)
        left = 0.004 * np.exp(-drift.warm_up / tau)
        assert 0.0 < left < 0.0005
        assert drift.warm_up < 450
        assert drift.found < 0.0003


def test_slow_noise_is_rarely_taken_for_the_warming_up() -> None:
    rng = np.random.default_rng(0)
    found = [measure_drift(0.05 + 0.0005 * flicker(int(600 * RATE), rng), RATE).warm_up for _ in range(40)]
    assert sum(each > 0 for each in found) <= 4


def test_outliers_and_gaps_do_not_matter() -> None:
    rng = np.random.default_rng(0)
    readings = 0.05 + 0.001 * rng.standard_normal(int(300 * RATE))
    readings[rng.uniform(size=len(readings)) < 0.02] = 0.2
    readings[rng.uniform(size=len(readings)) < 0.3] = np.nan
    drift = measure_drift(readings, RATE)
    assert drift.found < 0.0002
    assert drift.white_std == pytest.approx(0.001, rel=0.1)


@pytest.mark.parametrize("seconds", [0.0, 60.0])
def test_too_short_a_measurement_is_refused(seconds: float) -> None:
    with pytest.raises(InvalidInput, match="too few ranges"):
        measure_drift(np.full(int(seconds * RATE), 0.05), RATE)


def test_a_target_that_goes_away_is_refused() -> None:
    readings = np.full(int(300 * RATE), 0.05)
    readings[2000:3000] = np.nan
    with pytest.raises(InvalidInput, match="too few ranges"):
        measure_drift(readings, RATE)
