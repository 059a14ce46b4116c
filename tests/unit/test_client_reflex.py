"""The reflex never lets the tip sink towards what it sees or cannot see, at a bounded speed, and comes to rest."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pretouch.client import Reflex
from pretouch.client.reflex import RANGE_UNDERFLOW
from pretouch.geometry import Pose

NO_TARGET = 7
readings = st.one_of(
    st.tuples(st.floats(0.0, 0.12), st.just(0)),
    st.tuples(st.just(np.nan), st.sampled_from([6, NO_TARGET, RANGE_UNDERFLOW])),
    st.tuples(st.floats(0.0, 0.12), st.sampled_from([6, RANGE_UNDERFLOW])),
)
Step = tuple[list[tuple[float, int]], float]


def steps(modules: int) -> st.SearchStrategy[list[Step]]:
    step = st.tuples(st.lists(readings, min_size=modules, max_size=modules), st.floats(0.0, 0.2))
    return st.lists(step, max_size=40)


def update(reflex: Reflex, reading: list[tuple[float, int]], elapsed: float) -> Reflex:
    ranges, status = zip(*reading, strict=True)
    return reflex.update(ranges, status, elapsed)


@given(st.integers(1, 3).flatmap(steps))
def test_the_tip_never_sinks_towards_what_is_near_or_unseen(scan: list[Step]) -> None:
    reflex = Reflex()
    for reading, elapsed in scan:
        before, reflex = reflex, update(reflex, reading, elapsed)
        rise = reflex.lift - before.lift
        assert 0 <= reflex.lift <= reflex.highest
        assert -reflex.sink_speed * elapsed - 1e-12 <= rise <= reflex.lift_speed * elapsed + 1e-12
        near = any(metres < reflex.closest or code == RANGE_UNDERFLOW for metres, code in reading)
        if near:
            assert rise == pytest.approx(min(reflex.lift_speed * elapsed, reflex.highest - before.lift))
        good = [metres for metres, code in reading if code == 0]
        if not good:
            assert rise >= 0
        if rise < 0:
            assert min(good) + rise >= reflex.clear - 1e-12


@given(st.integers(1, 3).flatmap(steps))
def test_a_tip_that_goes_blind_comes_to_rest_no_lower(scan: list[Step]) -> None:
    reflex = Reflex()
    for reading, elapsed in scan:
        reflex = update(reflex, reading, elapsed)
    blind, modules = reflex, len(reflex.ahead)
    for _ in range(20):
        blind = blind.update([np.nan] * modules, [NO_TARGET] * modules, 0.033)
    assert reflex.lift <= blind.lift <= reflex.lift + reflex.clear + 0.033 * reflex.lift_speed
    assert blind.update([np.nan] * modules, [NO_TARGET] * modules, 0.033).lift == blind.lift


def test_over_a_step_the_tip_rises_and_comes_back_to_the_plan() -> None:
    reflex, lifts = Reflex(), []
    for surface in [0.0] * 10 + [0.025] * 30 + [0.0] * 60:
        reflex = reflex.update(0.03 + reflex.lift - surface, 0, 1 / 30)
        lifts.append(reflex.lift)
    assert lifts[9] == 0
    assert 0.030 - 0.025 + max(lifts) >= reflex.clear - 1e-9
    assert max(lifts) < 0.03
    assert lifts[-1] == 0


def test_a_target_too_near_to_be_measured_lifts_the_tip_until_it_is_seen() -> None:
    reflex = Reflex()
    for _ in range(60):
        metres = 0.004 + reflex.lift
        status = RANGE_UNDERFLOW if metres < 0.01 else 0
        reflex = reflex.update(np.nan if status else metres, status, 1 / 30)
    assert reflex.clear <= 0.004 + reflex.lift < 0.031
    assert not reflex.rising


def test_ranges_that_wander_near_the_target_do_not_end_the_rise() -> None:
    reflex = Reflex().update(0.012, 0, 1 / 30)
    assert reflex.rising
    after = reflex.update(0.022, 0, 1 / 30)
    assert after.lift > reflex.lift
    assert not after.update(0.026, 0, 1 / 30).rising
    assert not Reflex().update(0.022, 0, 1 / 30).rising


def test_losing_sight_of_something_near_lifts_even_without_a_code_for_it() -> None:
    reflex = Reflex().update(0.018, 0, 1 / 30)
    assert reflex.lift == 0
    assert reflex.update(np.nan, NO_TARGET, 1 / 30).lift > 0
    far = Reflex().update(0.06, 0, 1 / 30)
    assert far.update(np.nan, NO_TARGET, 1 / 30).lift == 0


def test_a_stuck_sensor_lifts_no_higher_than_the_limit() -> None:
    reflex = Reflex()
    for _ in range(300):
        reflex = reflex.update(0.005, 0, 1 / 30)
    assert reflex.lift == reflex.highest


def test_the_tip_is_raised_against_its_beam() -> None:
    tilted = Pose.from_rotation_vector([np.pi - 0.3, 0.0, 0.0], [0.1, 0.2, 0.3]).matrix
    reflex = Reflex(lift=0.02)
    raised = reflex.raise_tip(tilted)
    np.testing.assert_array_equal(raised[:3, :3], tilted[:3, :3])
    np.testing.assert_allclose(raised[:3, 3] - tilted[:3, 3], -0.02 * tilted[:3, 2])
    np.testing.assert_array_equal(tilted[:3, 3], [0.1, 0.2, 0.3])
