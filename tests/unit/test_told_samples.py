"""However the samples of a scan are told, the session becomes what one submission of all of them makes it."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.loop_fakes import FormulaRegistrar, RandomDetector, answer, asked, opened, samples_of
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_orchestrator.sessions.loop import Loop
from pretouch_orchestrator.sessions.progress import MIN_SAMPLES, is_assessable
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.sessions.told import add_told

from pretouch.errors import Conflict, InvalidInput
from pretouch.geometry import Pose
from pretouch.session import Budget, GatewaySpan, SampleChunk, Skipped
from pretouch.tof import RangeSamples, Sensor
from pretouch.wire.json import session_to_json

NOTHING = RangeSamples.concatenate([])
LOOP = Loop(RandomDetector(6), FormulaRegistrar(0.001))
START = opened(LOOP, asked(budget=Budget(4, 1e5, 1.0)))
SAMPLES = samples_of(START)
N = len(SAMPLES)
WHOLE = answer(LOOP, START, SAMPLES)
"""The session after one submission of all samples."""


class HeldSamples:
    """A gateway that holds the samples from number `start` to `end`."""

    def __init__(self, samples: RangeSamples, start: int, end: int) -> None:
        self.samples = samples.select(slice(start, end))

    async def get_samples(self, span: GatewaySpan) -> RangeSamples:
        return self.samples


def cut(start: int, end: int) -> RangeSamples:
    return SAMPLES.select(slice(start, end))


def as_seen(record: Record) -> dict[str, Any]:
    """The session as its client sees it, without what says how the tip moved."""
    seen = session_to_json(record.to_session())
    for scan in seen["scans"]:
        del scan["duration"], scan["length"]
    del seen["budget_used"]["seconds"]
    return seen


def assert_same_scan(record: Record) -> None:
    assert as_seen(record) == as_seen(WHOLE)
    np.testing.assert_array_equal(record.measured[0].ranges, WHOLE.measured[0].ranges)
    np.testing.assert_array_equal(record.measured[0].origins, WHOLE.measured[0].origins)
    assert record.told == ()
    assert record.scans[0].duration == record.budget_used.seconds == pytest.approx(SAMPLES.t[-1] - SAMPLES.t[0])


cuts = st.lists(st.tuples(st.integers(0, N), st.integers(0, N)), max_size=12)
"""Chunks by their first and last sample: with gaps, overlaps, repetitions, and some that are empty."""


@settings(max_examples=30, deadline=None)
@given(cuts, st.integers(1, N))
def test_any_chunks_make_the_same_session_as_one_submission(spans: list[tuple[int, int]], least: int) -> None:
    record = START
    for start, end in [(0, least), *spans]:
        told = len(record.told_samples)
        chunk = SampleChunk(start, cut(start, max(start, end)))
        if start > told:
            with pytest.raises(Conflict, match=f"told is {told}"):
                add_told(record, chunk)
            continue
        record = add_told(record, chunk)
        assert len(record.told_samples) == max(told, end)
        assert add_told(record, chunk) is record
        assert session_to_json(record.to_session()) == session_to_json(START.to_session())
    assert_same_scan(answer(LOOP, record, cut(len(record.told_samples), N)))


@settings(max_examples=30, deadline=None)
@given(cuts, st.booleans())
def test_any_spans_of_the_gateway_make_the_same_session(spans: list[tuple[int, int]], whole: bool) -> None:
    record = START
    known: set[int] = set()
    for start, end in [*spans, (0, 1)]:
        record = add_told(record, HeldSamples(SAMPLES, start, end).samples)
        known |= set(range(start, end))
        assert len(record.told_samples) == len(known)
    if not whole:
        record = add_told(record, SAMPLES)
    loop = Loop(RandomDetector(6), FormulaRegistrar(0.001), gateway=HeldSamples(SAMPLES, 0, N))
    assert record.next_scan is not None
    closing = GatewaySpan("", 0.0, 1.0) if whole else NOTHING
    assert_same_scan(asyncio.run(loop.advance(record, record.next_scan.scan_id, closing)))


def test_modules_that_measure_at_the_same_time_are_told_apart() -> None:
    sensor = Sensor(tip_T_module=(Pose.identity(), Pose.identity()))
    start = replace(START, request=replace(START.request, sensor=sensor))
    both = RangeSamples(
        np.repeat(SAMPLES.t, 2),
        np.repeat(SAMPLES.base_T_tip, 2, axis=0),
        np.repeat(SAMPLES.range, 2),
        np.zeros(2 * N, int),
        np.tile([0, 1], N),
    )
    record = add_told(start, both.select(both.module == 0))
    record = add_told(record, both.select(slice(0, N)))
    record = add_told(record, both)
    assert len(record.told_samples) == 2 * N
    assert (np.bincount(record.told_samples.module) == N).all()


def test_samples_are_assessed_once_a_module_has_enough_of_them() -> None:
    assert not is_assessable(add_told(START, SampleChunk(0, cut(0, MIN_SAMPLES - 1))))
    assert is_assessable(add_told(START, SampleChunk(0, cut(0, MIN_SAMPLES))))


@settings(max_examples=20, deadline=None)
@given(st.integers(MIN_SAMPLES, N))
def test_an_assessment_says_what_closing_would_do(count: int) -> None:
    loop = Loop(RandomDetector(6), FormulaRegistrar(0.3))
    record = add_told(START, SampleChunk(0, cut(0, count)))
    assessment = asyncio.run(loop.assess(record))
    after = answer(loop, record, NOTHING)
    assert assessment.enough == (after.state == "converged")
    assert assessment[1:] == (after.estimate.expected_error, after.estimate.error_quantile)


def test_what_was_told_of_a_skipped_scan_is_dropped() -> None:
    told = add_told(START, SampleChunk(0, SAMPLES))
    assert session_to_json(answer(LOOP, told, Skipped()).to_session()) == session_to_json(
        answer(LOOP, START, Skipped(SAMPLES)).to_session()
    )
    assert answer(LOOP, told, Skipped()).told == ()


def test_the_rest_must_follow_what_was_told() -> None:
    told = add_told(START, SampleChunk(0, cut(0, 9)))
    with pytest.raises(InvalidInput, match="before the last sample"):
        answer(LOOP, told, SAMPLES)
    with pytest.raises(InvalidInput, match="before the last sample"):
        add_told(told, SampleChunk(9, cut(3, 9)))
