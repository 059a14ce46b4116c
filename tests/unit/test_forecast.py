"""The forecast of a session keeps within its budget, and changes with what it is made of in the way it should."""

from __future__ import annotations

import numpy as np
from helpers.loop_fakes import FormulaRegistrar, RandomDetector, answer, asked, opened, samples_of
from hypothesis import given
from hypothesis import strategies as st
from pretouch_orchestrator.sessions.forecast import (
    ENOUGH_SCANS,
    ENOUGH_SECONDS,
    Features,
    compute_forecast,
    describe,
)
from pretouch_orchestrator.sessions.loop import Loop

from pretouch.session import Budget, Skipped, Tolerance

features = st.builds(
    Features,
    constant=st.just(1.0),
    need=st.floats(0.0, 6.0),
    gain=st.floats(0.0, 3.0),
    scans=st.floats(0.0, float(np.log(ENOUGH_SCANS))),
    seconds=st.floats(0.0, float(np.log(ENOUGH_SECONDS))),
    tolerance=st.floats(-3.0, 7.0),
    cone=st.floats(0.0, 7.0),
    begun=st.sampled_from([0.0, 1.0]),
)


@given(features, st.integers(1, 1000), st.floats(0.1, 1e6))
def test_a_forecast_keeps_within_the_budget(known: Features, scans: int, seconds: float) -> None:
    forecast = compute_forecast(known, scans, seconds)
    assert 1 <= forecast.scans <= scans
    assert 0 < forecast.seconds <= seconds
    assert 0 < forecast.chance < 1


@given(features, st.floats(0.0, 2.0))
def test_more_to_do_lowers_the_chance_and_more_budget_raises_it(known: Features, more: float) -> None:
    chance = compute_forecast(known, 10, 100.0).chance
    assert compute_forecast(known._replace(need=known.need + more), 10, 100.0).chance <= chance
    assert compute_forecast(known._replace(gain=known.gain + more), 10, 100.0).chance >= chance
    assert compute_forecast(known._replace(scans=known.scans + more), 10, 100.0).chance >= chance
    assert compute_forecast(known._replace(seconds=known.seconds + more), 10, 100.0).chance >= chance


def test_every_state_that_awaits_a_scan_has_a_forecast_and_no_other() -> None:
    loop = Loop(RandomDetector(), FormulaRegistrar())
    record = opened(loop, asked(budget=Budget(scans=3)))
    assert record.forecast == compute_forecast(describe(record), 3, record.request.budget.seconds)
    record = answer(loop, record, Skipped())
    assert record.forecast is not None
    while record.next_scan is not None:
        assert record.to_session().forecast == record.forecast
        assert record.forecast is not None
        record = answer(loop, record, samples_of(record))
    assert record.state.ended
    assert record.forecast is None


def test_the_features_say_what_the_record_says() -> None:
    loop = Loop(RandomDetector(), FormulaRegistrar())
    record = opened(loop, asked(budget=Budget(scans=1000, seconds=1e6), tolerance=Tolerance(0.005)))
    known = describe(record)
    assert known.need == np.log(record.estimate.error_quantile / 0.005)
    assert known.gain == np.log(record.estimate.expected_error / min(r.expected_error for r in record.regions))
    assert (known.scans, known.seconds) == (np.log(ENOUGH_SCANS), np.log(ENOUGH_SECONDS))
    assert known.begun == 0.0
    after = answer(Loop(RandomDetector(), FormulaRegistrar(gain=0.01)), record, samples_of(record))
    assert describe(after).begun == 1.0
