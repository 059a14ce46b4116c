"""Whether the samples told so far are enough: assessed in the background, one registration a session at a time."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Protocol

import numpy as np
import structlog

from pretouch.errors import PretouchError
from pretouch.estimate import Estimate
from pretouch.session import ScanProgress
from pretouch_orchestrator.sessions.endings import has_converged
from pretouch_orchestrator.sessions.record import Record

PATIENCE = 0.14
"""s that an answer waits for the assessment of its own samples."""
MIN_SAMPLES = 20
"""Least samples of a module that are assessed: with fewer the sensor check sees no stuck or noisy module."""
_MAX_SCANS = 1000
"""Scans under way that are remembered."""


class Assessment(NamedTuple):
    """What the session would be, had its scan ended with the samples told so far; errors in m."""

    enough: bool
    expected_error: float
    error_quantile: float

    @staticmethod
    def of(record: Record, estimate: Estimate) -> Assessment:
        """With `estimate` as the session's."""
        enough = has_converged(replace(record, estimate=estimate))
        return Assessment(enough, estimate.expected_error, estimate.error_quantile)


def is_assessable(record: Record) -> bool:
    """Whether enough samples were told to assess them at all."""
    modules = record.told_samples.module
    return len(modules) > 0 and int(np.bincount(modules).max()) >= MIN_SAMPLES


def _pending(record: Record) -> str:
    """The name of the scan that the session waits for."""
    return "" if record.next_scan is None else record.next_scan.scan_id


class Assessor(Protocol):
    """What assesses the samples told of a session's scan: the loop."""

    async def assess(self, record: Record) -> Assessment: ...


@dataclass(eq=False)
class _Scan:
    """A scan under way.

    Attributes:
        scan_id: its name in the session.
        waiting: the newest record that has not been assessed yet.
        assessed: number of samples that `assessment` knows.
        changed: set when `assessment` or `task` has changed.
    """

    scan_id: str = ""
    waiting: Record | None = None
    assessed: int = 0
    assessment: Assessment | None = None
    task: asyncio.Task[None] | None = None
    changed: asyncio.Event = field(default_factory=asyncio.Event)

    def wake(self) -> None:
        self.changed.set()
        self.changed = asyncio.Event()


class ScanAssessments:
    """The assessments of all scans under way that were told here. Each session has at most one at a time, always of its
    newest samples.

    Nothing depends on them: another process assesses what it is told anew, and what was forgotten here is too.
    """

    def __init__(self, assessor: Assessor, log: structlog.typing.FilteringBoundLogger) -> None:
        self._assessor = assessor
        self._log = log
        self._scans: OrderedDict[str, _Scan] = OrderedDict()

    def start(self, record: Record) -> None:
        """Has the samples told so far assessed, after the assessment under way."""
        scan = self._find(record)
        known = scan.assessed if scan.waiting is None else len(scan.waiting.told_samples)
        if is_assessable(record) and len(record.told_samples) > known:
            scan.waiting = record
            if scan.task is None:
                scan.task = asyncio.create_task(self._run(scan))

    def _find(self, record: Record) -> _Scan:
        """The session's scan under way. Scans of sessions that went on elsewhere are forgotten in time."""
        scan = self._scans.get(record.id)
        if scan is None or scan.scan_id != _pending(record):
            self.drop(record.id)
            scan = self._scans[record.id] = _Scan(_pending(record))
        self._scans.move_to_end(record.id)
        while len(self._scans) > _MAX_SCANS:
            self.drop(next(iter(self._scans)))
        return scan

    async def get_progress(self, record: Record) -> ScanProgress:
        """The progress after the samples of `record`: as they are assessed, or, after PATIENCE, as known by then."""
        told, scan = len(record.told_samples), self._scans.get(record.id)
        if scan is None or scan.scan_id != _pending(record):
            scan = _Scan()
        with suppress(TimeoutError):
            async with asyncio.timeout(PATIENCE):
                while scan.task is not None and scan.assessed < told:
                    await scan.changed.wait()
        present = record.estimate
        known = scan.assessment or Assessment(False, present.expected_error, present.error_quantile)
        return ScanProgress(told, *known)

    def drop(self, session_id: str) -> None:
        """Cancels the assessment of the session's scan, which is closed."""
        scan = self._scans.pop(session_id, None)
        if scan is not None and scan.task is not None:
            scan.task.cancel()

    async def close(self) -> None:
        """Cancels all assessments."""
        tasks = [scan.task for scan in self._scans.values() if scan.task is not None]
        for session_id in list(self._scans):
            self.drop(session_id)
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _run(self, scan: _Scan) -> None:
        """Assesses until no newer samples wait. What cannot be assessed now is assessed with the next samples."""
        try:
            while scan.waiting is not None:
                record, scan.waiting = scan.waiting, None
                scan.assessment = await self._assessor.assess(record)
                scan.assessed = len(record.told_samples)
                scan.wake()
        except PretouchError as error:
            self._log.warning("samples under way were not assessed", problem=error.detail)
        except Exception as error:
            self._log.error("the assessment of samples met a defect", exc_info=error)
        finally:
            scan.task = None
            scan.wake()
