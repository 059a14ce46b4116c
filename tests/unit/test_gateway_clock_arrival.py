"""Lines of devices that answer no pings get a time too, and an honest deviation."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from pretouch_sensor_gateway.clock.arrival_clock import ArrivalClock
from pretouch_sensor_gateway.clock.tick_unwrapper import TickUnwrapper

from benchmarks.clock_devices import START, WRAP, Delay, Oscillator, hiccups, latency_timer, usb
from benchmarks.text_devices import TEXT_CASES, print_lines

PERIOD = 1 / 30
ON_THE_WIRE = 0.002
DELAYS = {"USB": usb(1e-4), "latency timer": latency_timer(1e-3), "hiccups": hiccups(latency_timer(1e-3))}
OSCILLATORS = {
    "crystal": Oscillator(30e-6, swing=10e-6),
    "resonator": Oscillator(5e-3, swing=5e-5),
    "RC": Oscillator(-0.05, swing=5e-4),
    "counts milliseconds": Oscillator(-20e-6, resolution=1e-3),
}


def heard(
    delay: Delay,
    oscillator: Oscillator | None,
    seconds: float = 300.0,
    period: float = PERIOD,
    damaged: float = 0.0,
    silence: tuple[float, float] = (np.inf, np.inf),
) -> NDArray[np.float64]:
    """(4, n): age, error and std of lines' times, and where in its period each was measured, 0-1: elsewhere every 10 s.

    Args:
        damaged: share of lines with a wrong time.
    """
    rng = np.random.default_rng(7)
    clock, counter = ArrivalClock(), TickUnwrapper(WRAP)
    rows = []
    begin, last, phase = START, 0.0, 0.5
    for number in range(round(seconds / period)):
        begin += period * (1 + 1e-3 * rng.standard_normal())
        if silence[0] <= begin - START < silence[1]:
            continue
        if number % round(10 / period) == 0:
            phase = rng.uniform()
        last = arrival = max(last, begin + ON_THE_WIRE + delay(rng))
        device = None
        if oscillator is not None:
            micros = (
                oscillator.micros(begin) + (rng.integers(-4_000_000, 4_000_000) if rng.uniform() < damaged else 0)
            ) % WRAP
            if not counter.follows(micros, arrival):
                continue
            device = counter.unwrap(micros, arrival)
        found = clock.host_time(arrival, ON_THE_WIRE, device)
        rows.append((begin - START, found.at - (begin - phase * period), found.std, phase))
    return np.array(rows).T


@pytest.mark.parametrize("delay", DELAYS)
@pytest.mark.parametrize("oscillator", [*OSCILLATORS, None])
def test_errors_are_as_stated(delay: str, oscillator: str | None) -> None:
    _, error, std, _ = heard(DELAYS[delay], OSCILLATORS[oscillator] if oscillator else None)
    error = np.abs(error)
    assert np.mean(error <= 3 * std) >= (0.99 if "hiccups" not in delay or oscillator else 0.97)
    assert np.mean(error <= 2 * std) >= 0.93
    assert np.median(std) <= 3 * np.median(error)


@pytest.mark.parametrize("delay", DELAYS)
@pytest.mark.parametrize("oscillator", OSCILLATORS)
def test_a_devices_own_time_removes_the_jitter_of_arrival(delay: str, oscillator: str) -> None:
    age, error, _, phase = heard(DELAYS[delay], OSCILLATORS[oscillator])
    begun = error - (phase - 0.5) * PERIOD  # the error but for where in its period the measurement was
    begun = begun[age > 30]
    assert np.std(begun) < (1e-3 if oscillator != "RC" else 2e-3)
    assert np.abs(np.mean(begun)) < (3e-3 if oscillator != "RC" else 6e-3)


def test_a_line_without_a_time_is_half_a_period_older_than_its_arrival() -> None:
    clock = ArrivalClock()
    first = clock.host_time(100.0, 0.002, None)
    assert first.at == pytest.approx(100.0 - 0.002 - 0.05)  # a tenth of a second is assumed
    assert first.std > 0.1 / 12**0.5
    for k in range(1, 40):
        found = clock.host_time(100.0 + 0.02 * k, 0.002, None)
    assert found.at == pytest.approx(100.78 - 0.002 - 0.01)
    assert found.std == pytest.approx(np.hypot(0.02 / 12**0.5, 0.016 / 3**0.5))


@pytest.mark.parametrize("device", [None, 50.0])
def test_a_latency_that_is_stated_is_subtracted_and_leaves_no_doubt_about_the_period(device: float | None) -> None:
    stated, unstated = ArrivalClock(0.022), ArrivalClock()
    found, guessed = stated.host_time(100.0, 0.01, device), unstated.host_time(100.0, 0.01, device)
    assert found.at == pytest.approx(100.0 - 0.01 - 0.022)
    assert found.std**2 == pytest.approx(guessed.std**2 - 0.1**2 / 12)
    assert (stated.latency, unstated.latency) == (0.022, 0.05)


@pytest.mark.parametrize("board", TEXT_CASES)
def test_lines_read_byte_by_byte_are_timed_as_stated(board: str) -> None:
    case = TEXT_CASES[board]
    runs = [print_lines(case, 20.0, seed) for seed in range(4)]
    error = np.concatenate([error[len(error) // 4 :] for error, _ in runs])
    std = np.concatenate([std[len(std) // 4 :] for _, std in runs])
    assert np.mean(np.abs(error) <= 3 * std) >= 0.98
    if case.stated is not None:
        assert np.sqrt(np.mean(error**2)) < 2e-3


def test_lines_that_come_in_one_read_are_as_old_as_each_other() -> None:
    clock = ArrivalClock()
    for read in range(40):
        found = [clock.host_time(100.0 + 0.016 * read, 0.0, None) for _ in range(8)]
        assert len(set(found)) == 1 or read == 0
    assert found[0].at == pytest.approx(100.0 + 0.016 * 39 - 0.008)


def test_a_pause_is_no_period() -> None:
    clock = ArrivalClock()
    for k in range(40):
        clock.host_time(100.0 + 0.02 * k, 0.0, None)
    after = clock.host_time(800.0, 0.0, None)
    assert after.at == pytest.approx(800.0 - 0.01)
    assert after.std < 0.02


def test_no_line_began_after_it_arrived() -> None:
    clock = ArrivalClock()
    for k in range(100):
        clock.host_time(100.0 + 0.02 * k + 0.010, 0.0, 0.02 * k)
    quick = clock.host_time(100.0 + 0.02 * 100, 0.0, 0.02 * 100)  # ten milliseconds quicker than all before
    assert quick.at <= 102.0 - 0.01 + 1e-9


def test_damaged_times_do_no_lasting_harm() -> None:
    age, error, std, _ = heard(DELAYS["latency timer"], OSCILLATORS["crystal"], damaged=0.01)
    good = (np.abs(error) <= 3 * std)[age > 5]
    assert np.mean(good) > 0.98


def test_minutes_of_silence_are_bridged() -> None:
    age, error, std, _ = heard(DELAYS["USB"], OSCILLATORS["resonator"], seconds=900, silence=(100, 700))
    after = age > 700
    assert after.sum() > 5000
    assert np.mean(np.abs(error)[after] <= 2 * std[after]) >= 0.93


@pytest.mark.parametrize(("step", "seconds"), [(-0.5, 15), (0.5, 8)])
def test_a_device_clock_that_stepped_is_followed(step: float, seconds: float) -> None:
    """That it stands still for a while looks like a busy host, which is believed for ten seconds."""
    clock, rng = ArrivalClock(), np.random.default_rng(2)
    errors = []
    for made in np.arange(0.0, 40.0 + seconds, PERIOD).tolist():
        stepped = made + step * (made >= 40.0)
        found = clock.host_time(START + made + rng.uniform(0, 0.016), 0.0, stepped)
        errors.append(found.at - (START + made - PERIOD / 2))
    assert np.std(errors[-30:]) < 2e-3
    assert np.abs(np.mean(errors[-30:])) < 5e-3


def test_a_slow_device_with_late_lines_keeps_a_steady_time() -> None:
    """One line a second leaves nothing to choose from: a late one counts the less for it."""
    age, error, _, phase = heard(DELAYS["hiccups"], OSCILLATORS["crystal"], seconds=600, period=1.0)
    begun = (error - (phase - 0.5))[age > 100]
    assert np.std(begun) < 1.5e-3
    assert np.abs(np.mean(begun)) < 4.5e-3


def test_a_restart_voids_the_devices_clock_but_not_its_period() -> None:
    clock = ArrivalClock()
    for k in range(100):
        clock.host_time(START + PERIOD * k, 0.0, PERIOD * k)
    clock.restart()
    found = clock.host_time(START + 10.0, 0.0, 0.25)
    assert found.at == pytest.approx(START + 10.0 - PERIOD / 2)
    assert found.std < PERIOD
