"""The session's state machine: each step makes a new record of an old one; nothing here waits or forgets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from pretouch.errors import Conflict, InvalidInput, NotFound
from pretouch.estimate import Estimate
from pretouch.exhaustion import Exhaustion
from pretouch.session import Points, Region, ScanPlan, ScanSummary
from pretouch.tof import RangeSamples, Scan
from pretouch.trajectory import Trajectory
from pretouch_orchestrator.perception.sensor_check import judge, told, without
from pretouch_orchestrator.planning.coverage import scanned
from pretouch_orchestrator.planning.planner import Candidate, choose
from pretouch_orchestrator.sessions.endings import exhausted
from pretouch_orchestrator.sessions.record import Record


def awaited(record: Record, scan_id: str) -> ScanPlan:
    """The plan that an answer for `scan_id` belongs to.

    Raises:
        Conflict: the session has ended.
        NotFound: no such scan is planned.
    """
    if record.state.ended:
        raise Conflict(
            f"The session is {record.state.value}; no scan is wanted any more.", "Open a new session to go on."
        )
    if record.next_scan is None or record.next_scan.scan_id != scan_id:
        raise NotFound(f"The session has no scan {scan_id!r:.80}.", "Send the scan_id of the session's next_scan.")
    return record.next_scan


def checked(record: Record, submission: RangeSamples | Points) -> tuple[RangeSamples | Points, str]:
    """What is left of a scan without the modules that measured nothing; and if that is nothing, why, in sentences."""
    if isinstance(submission, Points):
        return submission, ""
    verdicts = judge(submission, record.request.sensor, record.scene, record.estimate, record.measured)
    left = without(submission, [verdict.module for verdict in verdicts])
    return left, told(verdicts) if verdicts and len(left) == 0 else ""


def measured(record: Record, submission: RangeSamples | Points) -> Scan:
    """What the client says of a scan, as beams in base.

    Raises:
        InvalidInput: there is nothing in it, or it does not fit the session's sensor.
    """
    if isinstance(submission, Points):
        down = -record.scene.table.moved(record.estimate.base_T_correction).normal
        scan = Scan.of_points(submission.points, down)
    else:
        scan = submission.beams(record.request.sensor)
    if len(scan) == 0:
        raise InvalidInput(
            "The scan is empty.", 'Send its samples, misses too, or {"skipped": "unreachable"} if it cannot be made.'
        )
    return scan


def used(record: Record, plan: ScanPlan, submission: RangeSamples | Points, scan: Scan, estimate: Estimate) -> Record:
    """After a scan: its evidence, the `estimate` from all scans with it, and what it cost.

    Args:
        submission: all that was sent.
        scan: what of it is believed.
    """
    duration, samples = plan.path.duration, len(scan)
    if isinstance(submission, RangeSamples):
        duration, samples = max(duration, float(submission.t[-1] - submission.t[0])), len(submission)
    summary = ScanSummary(
        scan_id=plan.scan_id,
        region_id=plan.region_id,
        samples=samples,
        returns=int(scan.returned.sum()),
        length=plan.path.length,
        duration=duration,
        expected_error=estimate.expected_error,
    )
    record = replace(
        record,
        estimate=estimate,
        scans=(*record.scans, summary),
        measured=(*record.measured, scan),
        answered=(*record.answered, plan.scan_id),
        next_scan=None,
    )
    spent = replace(
        record.budget_used,
        scans=len(record.scans),
        seconds=record.budget_used.seconds + duration,
        fraction=float(scanned(record.corrected_cloud(), record.measured).mean()),
    )
    return replace(record, budget_used=spent)


def passed_over(record: Record, plan: ScanPlan) -> Record:
    """After a scan that could not be made: neither evidence nor cost, and its region is not planned again."""
    return replace(
        record,
        skipped=(*record.skipped, plan.region_id),
        answered=(*record.answered, plan.scan_id),
        next_scan=None,
    )


def open_regions(record: Record) -> tuple[Region, ...]:
    """The regions that can still be planned; none once the scans are spent."""
    if record.budget_used.scans >= record.request.budget.scans:
        return ()
    closed = {*record.skipped, *(scan.region_id for scan in record.scans)}
    return tuple(region for region in record.regions if region.id not in closed)


def planned(
    record: Record, affordable: Sequence[tuple[str, Trajectory, float]], expected_errors: Sequence[float]
) -> Record:
    """With each region's expected error brought up to date, and the next scan; exhausted if there is none.

    Args:
        affordable: what can be scanned, see `budget.affordable`.
        expected_errors: m, predicted for each of them, in their order. Another scan of any other region is expected
            to tell nothing.
    """
    predicted = {region_id: error for (region_id, _, _), error in zip(affordable, expected_errors, strict=True)}
    present = record.estimate.expected_error
    regions = tuple(replace(region, expected_error=predicted.get(region.id, present)) for region in record.regions)
    record = replace(record, regions=regions)
    by_id = {region.id: region for region in regions}
    candidates = [Candidate(by_id[region_id], path, share) for region_id, path, share in affordable]
    best = choose(candidates, record.request.planner, present)
    if best is None:
        return exhausted(record, Exhaustion.NOTHING_TO_GAIN)
    scan_id = f"scan-{len(record.answered) + 1}"
    return replace(record, next_scan=ScanPlan(scan_id, best.region.id, best.path))
