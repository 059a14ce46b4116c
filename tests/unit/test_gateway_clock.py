"""Device time becomes host time: through drift, wraps, uneven delays and restarts."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_sensor_gateway.clock import MAX_DRIFT, DeviceClock, signed_difference

WRAP = 2**32


@given(st.integers(0, WRAP - 1), st.integers(-(2**31), 2**31 - 1))
def test_differences_of_wrapping_counters(old: int, step: int) -> None:
    assert signed_difference((old + step) % WRAP, old) == step


@given(
    first=st.integers(0, WRAP - 1),
    drift=st.floats(-5e-5, 5e-5),
    seed=st.integers(0, 1000),
    step=st.sampled_from([0.02, 1.0, 40.0]),
)
@settings(max_examples=40)
def test_samples_get_their_host_time_through_wraps_and_drift(first: int, drift: float, seed: int, step: float) -> None:
    rng = random.Random(seed)

    def micros(host: float) -> int:
        return (first + round((host - 1000.0) * 1e6 * (1 + drift))) % WRAP

    clock = DeviceClock()
    host = 1000.0
    for k in range(400):  # 4.4 hours at the longest step: 4 wraps
        host += step
        there, back = rng.uniform(0, 0.004), rng.expovariate(100)
        if k % 10 == 0:
            sent, received = host - there, host + back
            assert clock.follows(micros(host), received)
            clock.answered(sent, received, clock.unwrap(micros(host), received))
            continue
        arrival = host + back
        assert clock.follows(micros(host), arrival)
        found = clock.host_time(clock.unwrap(micros(host), arrival))
        assert found is not None
        # the last ping alone is good to its half round trip plus the drift since; a better one may only improve on it
        bound = (received - sent) / 2 + MAX_DRIFT * (arrival - sent) + 2e-6
        assert abs(found - host) <= bound
    assert clock.epoch == 0


def test_the_quickest_recent_ping_counts() -> None:
    clock = DeviceClock()
    clock.unwrap(0, 99.9)
    clock.answered(100.0, 100.001, 0.1)  # round trip 1 ms: the device's 0.1 s is 100.0005
    clock.answered(101.0, 101.2, 1.15)  # a slow one, which alone would say 49.5 ms otherwise
    assert clock.host_time(0.1) == pytest.approx(100.0005)
    clock.answered(140.0, 140.006, 40.1)  # after 40 s the old one may have drifted 4 ms: now this one counts
    assert clock.host_time(40.1) == pytest.approx(140.003)


def test_no_host_time_before_the_first_answer() -> None:
    clock = DeviceClock()
    assert not clock.synchronised
    assert clock.host_time(clock.unwrap(5, 1.0)) is None


def test_a_restart_does_not_follow_and_voids_what_was_known() -> None:
    clock = DeviceClock()
    device = clock.unwrap(3_000_000_000, 50.0)
    clock.answered(50.0, 50.001, device)
    assert clock.follows(3_001_000_000, 51.0)
    assert not clock.follows(20_000, 51.0)
    clock.restart()
    assert clock.epoch == 1
    assert not clock.synchronised
    assert clock.follows(20_000, 51.0)


def test_a_wrap_during_a_long_silence_is_no_restart() -> None:
    clock = DeviceClock()
    before = clock.unwrap(WRAP - 1_000_000, 0.0)
    silence = 2.5 * WRAP * 1e-6
    micros = (WRAP - 1_000_000 + round(silence * 1e6)) % WRAP
    assert clock.follows(micros, silence)
    assert clock.unwrap(micros, silence) - before == pytest.approx(silence)
