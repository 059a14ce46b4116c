"""The session's state machine: pure functions that derive a new record from an old one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from pretouch.errors import Conflict, InvalidInput, NotFound
from pretouch.estimate import Estimate
from pretouch.exhaustion import Exhaustion
from pretouch.session import Points, Region, ScanPlan, ScanSummary
from pretouch.tof import RangeSamples, Scan
from pretouch_orchestrator.perception.sensor_check import diagnose, drop_modules, summarize
from pretouch_orchestrator.planning.coverage import find_scanned
from pretouch_orchestrator.planning.planner import Candidate, choose
from pretouch_orchestrator.sessions.budget import AffordablePath
from pretouch_orchestrator.sessions.endings import exhaust_session
from pretouch_orchestrator.sessions.record import Record


def get_pending_plan(record: Record, scan_id: str) -> ScanPlan:
    """The plan of the scan that the session waits for, which must be `scan_id`.

    Raises:
        Conflict: the session has ended.
        NotFound: no such scan is planned.
    """
    if record.state.ended:
        raise Conflict(
            f"The session is {record.state.value} and takes no more scans.", "Open a new session to continue."
        )
    if record.next_scan is None or record.next_scan.scan_id != scan_id:
        raise NotFound(f"The session has no scan {scan_id!r:.80}.", "Send the scan_id of the session's next_scan.")
    return record.next_scan


def drop_faulty_modules(record: Record, submission: RangeSamples | Points) -> tuple[RangeSamples | Points, str]:
    """The submission without the samples of faulty modules, and what is wrong if no sample is left ("" otherwise)."""
    if isinstance(submission, Points):
        return submission, ""
    diagnoses = diagnose(submission, record.request.sensor, record.scene, record.estimate, record.measured)
    kept = drop_modules(submission, [diagnosis.module for diagnosis in diagnoses])
    return kept, summarize(diagnoses) if diagnoses and len(kept) == 0 else ""


def scan_from_submission(record: Record, submission: RangeSamples | Points) -> Scan:
    """The submission as beams in base.

    Raises:
        InvalidInput: it is empty, or it does not fit the session's sensor.
    """
    if isinstance(submission, Points):
        down = -record.scene.table.moved(record.estimate.base_T_correction).normal
        scan = Scan.of_points(submission.points, down)
    else:
        scan = submission.beams(record.request.sensor)
    if len(scan) == 0:
        raise InvalidInput(
            "The scan is empty.",
            'Send all of its samples, those without a return included, or {"skipped": "unreachable"} if the robot '
            "cannot make it.",
        )
    return scan


def apply_scan(
    record: Record, plan: ScanPlan, submission: RangeSamples | Points, scan: Scan, estimate: Estimate
) -> Record:
    """Adds a scan to the session: its beams, its summary and its cost.

    Args:
        submission: all that the client sent.
        scan: the part of it that is used.
        estimate: the estimate from all scans, this one included.
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
    budget_used = replace(
        record.budget_used,
        scans=len(record.scans),
        seconds=record.budget_used.seconds + duration,
        fraction=float(find_scanned(record.corrected_cloud(), record.measured).mean()),
    )
    return replace(record, budget_used=budget_used)


def skip_scan(record: Record, plan: ScanPlan) -> Record:
    """Closes a scan that the robot could not make: it costs nothing, and its region is not planned again."""
    return replace(
        record,
        skipped=(*record.skipped, plan.region_id),
        answered=(*record.answered, plan.scan_id),
        next_scan=None,
    )


def list_open_regions(record: Record) -> tuple[Region, ...]:
    """The regions that can still be planned: those neither scanned nor skipped; none once all scans are used up."""
    if record.budget_used.scans >= record.request.budget.scans:
        return ()
    closed = {*record.skipped, *(scan.region_id for scan in record.scans)}
    return tuple(region for region in record.regions if region.id not in closed)


def plan_next(record: Record, affordable: Sequence[AffordablePath], expected_errors: Sequence[float]) -> Record:
    """Updates each region's expected error and plans the best scan; exhausts the session if there is none.

    Args:
        affordable: the paths to choose from.
        expected_errors: m, predicted after each of them, in the same order. A scan of any other region is taken to
            leave the error as it is.
    """
    predicted = {option.region_id: error for option, error in zip(affordable, expected_errors, strict=True)}
    present = record.estimate.expected_error
    regions = tuple(replace(region, expected_error=predicted.get(region.id, present)) for region in record.regions)
    record = replace(record, regions=regions)
    by_id = {region.id: region for region in regions}
    candidates = [Candidate(by_id[option.region_id], option.path, option.share) for option in affordable]
    best = choose(candidates, record.request.planner, present)
    if best is None:
        return exhaust_session(record, Exhaustion.NOTHING_TO_GAIN)
    scan_id = f"scan-{len(record.answered) + 1}"
    return replace(record, next_scan=ScanPlan(scan_id, best.region.id, best.path))
