"""Assessments of scans under way: one at a time for each session, of the newest samples, gone with their scan."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest
import structlog
from helpers.records import a_record, after_telling
from pretouch_orchestrator.sessions import progress
from pretouch_orchestrator.sessions.progress import Assessment, ScanAssessments
from pretouch_orchestrator.sessions.record import Record

from pretouch.errors import Unavailable

ENOUGH = Assessment(True, 0.001, 0.002)


class HeldAssessor:
    """Assesses once it is let; notes how many samples it was given, and how many assessments were cancelled."""

    def __init__(self) -> None:
        self.seen: list[int] = []
        self.cancelled = self.running = self.most = 0
        self.go = asyncio.Event()
        self.error: Exception | None = None

    async def assess(self, record: Record) -> Assessment:
        self.seen.append(len(record.told_samples))
        self.running += 1
        self.most = max(self.most, self.running)
        try:
            await self.go.wait()
        except asyncio.CancelledError:
            self.cancelled += 1
            raise
        finally:
            self.running -= 1
        if self.error is not None:
            raise self.error
        return ENOUGH


def told(count: int, session_id: str = "one") -> Record:
    record = after_telling(a_record(session_id), count)
    (samples,) = record.told
    return replace(record, told=(replace(samples, module=samples.module * 0),))


def made() -> tuple[HeldAssessor, ScanAssessments]:
    assessor = HeldAssessor()
    return assessor, ScanAssessments(assessor, structlog.get_logger())


async def test_only_the_newest_samples_are_assessed_after_those_under_way() -> None:
    assessor, assessments = made()
    for count in (30, 40, 50, 60):
        assessments.start(told(count))
        await asyncio.sleep(0)
    after = await assessments.get_progress(told(60))
    assert (after.told, after.enough, after.expected_error) == (
        60,
        False,
        a_record().estimate.expected_error,
    )
    assessor.go.set()
    after = await assessments.get_progress(told(60))
    assert (after.enough, after.expected_error, after.error_quantile) == ENOUGH
    assert (assessor.seen, assessor.most) == ([30, 60], 1)


async def test_sessions_do_not_wait_for_each_other() -> None:
    assessor, assessments = made()
    assessments.start(told(30, "one"))
    assessments.start(told(30, "two"))
    await asyncio.sleep(0)
    assert assessor.running == 2
    await assessments.close()
    assert assessor.cancelled == 2


async def test_the_assessment_of_a_closed_scan_is_cancelled() -> None:
    assessor, assessments = made()
    assessments.start(told(30))
    waiting = asyncio.create_task(assessments.get_progress(told(30)))
    await asyncio.sleep(0)
    assessments.drop("one")
    assert (await waiting).enough is False
    assert assessor.cancelled == 1
    assert (await assessments.get_progress(told(30))).enough is False
    assert assessor.seen == [30]


async def test_a_failed_assessment_keeps_the_last_one_and_is_made_again_with_the_next_samples() -> None:
    assessor, assessments = made()
    assessor.go.set()
    assessments.start(told(30))
    assert (await assessments.get_progress(told(30))).enough
    for error in (Unavailable("gone", "wait"), ValueError("a defect")):
        assessor.error = error
        assessments.start(told(40))
        after = await assessments.get_progress(told(40))
        assert (after.told, after.enough) == (40, True)
    assessor.error = None
    assessments.start(told(40))
    await assessments.get_progress(told(40))
    assert assessor.seen == [30, 40, 40, 40]


async def test_samples_that_were_assessed_are_not_assessed_again() -> None:
    assessor, assessments = made()
    assessor.go.set()
    for _ in range(3):
        assessments.start(told(30))
        await assessments.get_progress(told(30))
    assert assessor.seen == [30]


async def test_a_scan_is_not_assessed_by_the_samples_of_one_before_it_that_was_closed_elsewhere() -> None:
    assessor, assessments = made()
    assessor.go.set()
    assessments.start(told(60))
    assert (await assessments.get_progress(told(60))).enough
    record = told(30)
    assert record.next_scan is not None
    following = replace(record, next_scan=replace(record.next_scan, scan_id="the next one"))
    assert not (await assessments.get_progress(following)).enough
    assessor.error = Unavailable("gone", "wait")
    assessments.start(following)
    assert not (await assessments.get_progress(following)).enough
    assert assessor.seen == [60, 30]


async def test_scans_that_went_on_elsewhere_are_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "_MAX_SCANS", 3)
    assessor, assessments = made()
    for count in range(10):
        assessments.start(told(30, f"session {count}"))
        await asyncio.sleep(0)
    await asyncio.sleep(0)
    assert (assessor.running, assessor.cancelled) == (3, 7)
    await assessments.close()
