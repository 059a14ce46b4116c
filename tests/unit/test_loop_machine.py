"""The invariants of a session hold for any sequence of submissions."""

from __future__ import annotations

import asyncio

import pytest
from helpers.loop_fakes import FormulaRegistrar, RandomDetector, answer, asked, misses, opened, samples_of
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from pretouch_orchestrator.sessions.endings import end_session
from pretouch_orchestrator.sessions.loop import Loop
from pretouch_orchestrator.sessions.record import Record

from pretouch.errors import Conflict, InvalidInput, NotFound
from pretouch.exhaustion import Exhaustion
from pretouch.session import Budget, Planner, Points, ScanSettings, Skipped, State
from pretouch.tof import RangeSamples


def exhaustion_of(record: Record) -> Exhaustion:
    assert record.reason is not None
    return Exhaustion(record.reason["type"].removeprefix("urn:pretouch:problem:"))


class SessionMachine(RuleBasedStateMachine):
    """Any order of submissions, repetitions, skips, nonsense and cancelling."""

    @initialize(
        scans=st.integers(1, 4),
        seconds=st.floats(1, 40),
        fraction=st.floats(0.1, 0.6),
        planner=st.sampled_from(Planner),
        gain=st.sampled_from([1e-4, 0.005, 10.0]),
    )
    def open(self, scans: int, seconds: float, fraction: float, planner: Planner, gain: float) -> None:
        self.registrar = FormulaRegistrar(gain)
        self.loop = Loop(RandomDetector(6), self.registrar)
        budget = Budget(scans, seconds, fraction)
        self.record = opened(self.loop, asked(budget=budget, planner=planner, scan=ScanSettings(0.03, 0.1)))
        self.planned: list[str] = []
        self.ended: Record | None = None
        self.note()

    def note(self) -> None:
        if self.record.next_scan is not None:
            self.planned.append(self.record.next_scan.path_id)

    def step(self, submission: RangeSamples | Points | Skipped) -> None:
        before = self.record
        self.record = answer(self.loop, before, submission)
        scanned = len(self.record.scans) > len(before.scans)
        if scanned and before.estimate.sensor_problem and self.record.estimate.sensor_problem:
            assert exhaustion_of(self.record) is Exhaustion.SENSOR
        self.note()

    @precondition(lambda self: self.record.next_scan is not None)
    @rule()
    def scan(self) -> None:
        self.step(samples_of(self.record))

    @precondition(lambda self: self.record.next_scan is not None)
    @rule()
    def miss(self) -> None:
        self.step(misses(3, span=0.1))

    @precondition(lambda self: self.record.next_scan is not None)
    @rule()
    def skip(self) -> None:
        self.step(Skipped())

    @precondition(lambda self: self.record.next_scan is not None)
    @rule()
    def send_nothing(self) -> None:
        with pytest.raises(InvalidInput):
            answer(self.loop, self.record, misses(0))

    @precondition(lambda self: self.record.answered)
    @rule(data=st.data())
    def repeat(self, data: st.DataObject) -> None:
        scan_id = data.draw(st.sampled_from(self.record.answered))
        assert asyncio.run(self.loop.advance(self.record, scan_id, misses(3))) is self.record

    @rule()
    def invent(self) -> None:
        with pytest.raises((NotFound, Conflict)):
            asyncio.run(self.loop.advance(self.record, "scan-99", misses(3)))

    @rule(fit=st.sampled_from([0.0, 0.00999, 0.01, 1.0]), problem=st.sampled_from(["", "", "All ranges are 31 mm."]))
    def doubt(self, fit: float, problem: str) -> None:
        self.registrar.fit, self.registrar.sensor_problem = fit, problem

    @rule(chance=st.integers(0, 5))
    def cancel(self, chance: int) -> None:
        if chance == 0:
            self.record = end_session(self.record, State.CANCELLED)

    @invariant()
    def an_end_is_final(self) -> None:
        assert self.record.state.ended == (self.record.next_scan is None)
        if self.ended is not None:
            assert self.record is self.ended
        elif self.record.state.ended:
            self.ended = self.record

    @invariant()
    def a_session_converges_on_explained_samples_only(self) -> None:
        if self.record.state is State.CONVERGED:
            assert self.record.estimate.fit >= 0.01
            assert not self.record.estimate.sensor_problem

    @invariant()
    def an_exhausted_session_says_why_and_no_other(self) -> None:
        record = self.record
        if record.state is not State.EXHAUSTED:
            assert record.reason is None
            return
        exhaustion = exhaustion_of(record)
        assert (exhaustion is Exhaustion.SENSOR) == bool(record.estimate.sensor_problem)
        if not record.estimate.sensor_problem:
            assert (exhaustion is Exhaustion.MISFIT) == (record.estimate.fit < 0.01)

    @invariant()
    def budgets_hold(self) -> None:
        budget, spent = self.record.request.budget, self.record.budget_used
        assert spent.scans <= budget.scans
        assert spent.seconds <= budget.seconds
        assert spent.fraction <= budget.fraction + 0.05

    @invariant()
    def no_skipped_path_is_planned_again_and_by_confidence_none_at_all(self) -> None:
        if self.record.next_scan is not None:
            assert self.record.next_scan.path_id not in self.record.skipped
        if self.record.request.planner is Planner.CONFIDENCE:
            assert len(set(self.planned)) == len(self.planned)

    @invariant()
    def books_balance(self) -> None:
        record = self.record
        assert record.budget_used.scans == len(record.scans) == len(record.measured)
        assert len(record.answered) == len(set(record.answered)) == len(record.scans) + len(record.skipped)
        assert all(region.expected_error > 0 for region in record.regions)


TestSessionMachine = SessionMachine.TestCase
TestSessionMachine.settings = settings(
    max_examples=12, stateful_step_count=8, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
