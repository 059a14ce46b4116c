"""Device ticks lose their wraps, and the Unix clock's jumps are noticed."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_sensor_gateway.clock.tick_unwrapper import MAX_JUMP, TickUnwrapper, signed_difference
from pretouch_sensor_gateway.clock.wall_clock import WallClock

from benchmarks.clock_devices import START, WRAP, Oscillator

MILLIS_WRAP = 2**32 * 1000


@given(st.integers(0, WRAP - 1), st.integers(-(2**31), 2**31 - 1))
def test_differences_of_wrapping_counters(old: int, step: int) -> None:
    assert signed_difference((old + step) % WRAP, old) == step


@given(st.integers(2, 2**40), st.integers(0, 2**41), st.integers(0, 2**41))
def test_a_difference_is_the_nearest_for_any_modulus(modulus: int, new: int, old: int) -> None:
    difference = signed_difference(new, old, modulus)
    assert (old + difference - new) % modulus == 0
    assert abs(difference) <= modulus // 2 + 1


@given(
    first=st.integers(0, MILLIS_WRAP - 1),
    modulus=st.sampled_from([2**32, MILLIS_WRAP, 65_536_000]),
    steps=st.lists(st.floats(1e-3, 20.0), min_size=1, max_size=60),
    seed=st.integers(0, 1000),
)
@settings(max_examples=60)
def test_seconds_go_on_through_wraps(first: int, modulus: int, steps: list[float], seed: int) -> None:
    rng = random.Random(seed)
    counter = TickUnwrapper(modulus)
    elapsed, start = 0, first % modulus
    began = counter.unwrap(start, 0.0)
    for step in steps:
        elapsed += round(step * 1e6)
        micros, arrival = (start + elapsed) % modulus, elapsed * 1e-6 + rng.uniform(0, 0.1)
        assert counter.follows(micros, arrival)
        assert counter.unwrap(micros, arrival) - began == pytest.approx(elapsed * 1e-6, abs=1e-6)


@pytest.mark.parametrize("drift", [50e-6, 5e-3])
def test_a_month_of_wraps_is_counted(drift: float) -> None:
    device = Oscillator(drift)
    counter = TickUnwrapper(WRAP)
    began = counter.unwrap(device.micros(START), START)
    month = 30 * 86400
    for age in range(60, month + 1, 60):
        micros = device.micros(START + age)
        assert counter.follows(micros, START + age)
        seconds = counter.unwrap(micros, START + age) - began
    assert seconds == pytest.approx(month * (1 + drift), abs=2e-6)


def test_a_wrap_during_a_long_silence_is_no_restart() -> None:
    counter = TickUnwrapper(WRAP)
    before = counter.unwrap(WRAP - 1_000_000, 0.0)
    silence = 2.5 * WRAP * 1e-6
    micros = (WRAP - 1_000_000 + round(silence * 1e6)) % WRAP
    assert counter.follows(micros, silence)
    assert counter.unwrap(micros, silence) - before == pytest.approx(silence)


@given(st.integers(0, WRAP - 1), st.floats(-60.0, 60.0))
def test_a_time_that_is_seconds_from_the_prediction_does_not_follow(first: int, jump: float) -> None:
    counter = TickUnwrapper(WRAP)
    counter.unwrap(first, 100.0)
    micros = (first + round((1.0 + jump) * 1e6)) % WRAP
    if abs(abs(jump) - MAX_JUMP) > 1e-5:
        assert counter.follows(micros, 101.0) == (abs(jump) < MAX_JUMP)
    counter.restart()
    assert counter.follows(micros, 101.0)
    assert counter.unwrap(micros, 101.0) == pytest.approx(micros * 1e-6)


def test_asking_whether_a_time_follows_changes_nothing() -> None:
    counter = TickUnwrapper(WRAP)
    counter.unwrap(WRAP - 10, 0.0)
    assert not counter.follows(2**31, 0.1)
    assert counter.follows(99_990, 0.1)
    assert counter.unwrap(99_990, 0.1) == pytest.approx((WRAP + 99_990) * 1e-6)


def test_the_unix_clock_is_followed() -> None:
    clock = WallClock()
    assert not clock.observe(10.0, 1_700_000_000.0)
    assert clock.unix(9.5) == pytest.approx(1_699_999_999.5)
    assert not clock.observe(20.0, 1_700_000_010.001)
    assert clock.unix(20.0) == pytest.approx(1_700_000_010.001)
    assert clock.jumps == 0


def test_slewing_is_no_jump() -> None:
    clock = WallClock()
    for second in range(0, 7200, 10):  # by NTP's fastest it gains 3.6 s
        assert not clock.observe(float(second), 1e9 + second * (1 + 500e-6))
    assert clock.jumps == 0
    assert clock.unix(7190.0) == pytest.approx(1e9 + 7190 * (1 + 500e-6))


def test_a_long_time_between_two_looks_allows_for_slewing() -> None:
    clock = WallClock()
    clock.observe(0.0, 1e9)
    assert not clock.observe(3600.0, 1e9 + 3601.8)
    assert clock.observe(3601.0, 1e9 + 3604.6)


@pytest.mark.parametrize("jump", [-3600.0, -0.06, 0.06, 3600.0])
def test_a_jump_is_noticed_once_and_followed(jump: float) -> None:
    clock = WallClock()
    clock.observe(10.0, 1e9)
    assert clock.observe(10.1, 1e9 + 0.1 + jump)
    assert clock.jumps == 1
    assert clock.unix(10.1) == pytest.approx(1e9 + 0.1 + jump)
    assert not clock.observe(10.2, 1e9 + 0.2 + jump)
    assert clock.jumps == 1


def test_a_busy_host_that_reads_its_clocks_apart_has_not_jumped() -> None:
    clock = WallClock()
    rng = random.Random(0)
    for k in range(100):
        assert not clock.observe(k * 0.03, 1e9 + k * 0.03 + rng.uniform(0, 0.02))


def test_no_unix_time_before_one_was_observed() -> None:
    with pytest.raises(RuntimeError, match="before it observed one"):
        WallClock().unix(1.0)
