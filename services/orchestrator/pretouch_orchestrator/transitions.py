"""The session's state machine: each step makes a new record of an old one; nothing here waits or forgets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from pretouch.errors import Conflict, InvalidInput, NotFound, PretouchError, problem
from pretouch.estimate import Estimate, point_error
from pretouch.geometry import Array
from pretouch.session import Points, Region, ScanPlan, ScanSummary, State
from pretouch.tof import RangeSamples, Scan
from pretouch.trajectory import Trajectory
from pretouch_orchestrator.coverage import Foresight, scanned
from pretouch_orchestrator.planner import Candidate, choose
from pretouch_orchestrator.record import Record

_MISJUDGED = 0.2
"""Share of a foreseen scan by which the real one may touch more of the object."""
_PARTS = (1.0, 0.5, 0.25)
"""How much of a region's path is scanned where the budget does not last for all of it."""
_MOVED = 0.01
"""Share of the object by which what earlier scans touched may change with the next correction."""


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
    """After a scan: its evidence, the `estimate` from all scans with it, and what it cost."""
    duration = plan.path.duration
    if isinstance(submission, RangeSamples):
        duration = max(duration, float(submission.t[-1] - submission.t[0]))
    summary = ScanSummary(
        scan_id=plan.scan_id,
        region_id=plan.region_id,
        samples=len(scan),
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
        fraction=float(scanned(_corrected_cloud(record), record.measured).mean()),
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


def has_converged(record: Record) -> bool:
    """Whether the tolerance's quantile of the object's mean point error is within its error."""
    tolerance, estimate = record.request.tolerance, record.estimate
    if tolerance.confidence == 0.95:
        return estimate.error_quantile <= tolerance.error
    centroid = estimate.base_T_correction.apply(estimate.centroid)
    _, quantile = point_error(estimate.covariance, _corrected_cloud(record), centroid, (tolerance.confidence,))
    return float(quantile[0]) <= tolerance.error


def open_regions(record: Record) -> tuple[Region, ...]:
    """The regions that can still be planned; none once the scans are spent."""
    if record.budget_used.scans >= record.request.budget.scans:
        return ()
    closed = {*record.skipped, *(scan.region_id for scan in record.scans)}
    return tuple(region for region in record.regions if region.id not in closed)


def affordable(record: Record, paths: Mapping[str, Trajectory]) -> list[tuple[str, Trajectory, float]]:
    """Each of `paths`, by region id, as far along as the budget lets, with its share of the budget that is left.

    The share is that of the scarcest budget. Foreseen scans get an allowance for what they may touch unforeseen, but
    not the first one: of a small object it touches much, and without it nothing would be known.
    """
    if not paths:
        return []
    budget, spent = record.request.budget, record.budget_used
    base_R_tip = next(iter(paths.values())).base_T_tip[0, :3, :3]
    foresight = Foresight(_corrected_cloud(record), record.measured, record.request.sensor, base_R_tip)

    def share(path: Trajectory) -> float:
        after = foresight.fraction_after(path)
        if record.scans:
            after += _MISJUDGED * max(after - spent.fraction, 0.0) + _MOVED
        return max(
            1 / max(budget.scans - spent.scans, 1e-9),
            path.duration / max(budget.seconds - spent.seconds, 1e-9),
            max(after - spent.fraction, 0.0) / max(budget.fraction - spent.fraction, 1e-9),
        )

    fitting = []
    for region_id, path in paths.items():
        for part in _PARTS:
            shortened = path.beginning(part)
            if (used_up := share(shortened)) <= 1:
                fitting.append((region_id, shortened, used_up))
                break
    return fitting


def planned(
    record: Record, affordable: Sequence[tuple[str, Trajectory, float]], expected_errors: Sequence[float]
) -> Record:
    """With each region's expected error brought up to date, and the next scan; exhausted if there is none.

    Args:
        affordable: what can be scanned, see there.
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
        return ended(record, State.EXHAUSTED)
    scan_id = f"scan-{len(record.answered) + 1}"
    return replace(record, next_scan=ScanPlan(scan_id, best.region.id, best.path))


def ended(record: Record, state: State, error: PretouchError | None = None) -> Record:
    """The session at its end, `error` being the reason of a failure; one that has ended stays as it is."""
    if record.state.ended:
        return record
    return replace(record, state=state, next_scan=None, reason=None if error is None else problem(error))


def _corrected_cloud(record: Record) -> Array:
    """(n, 3), m, in base: the object's points as presently corrected."""
    return np.asarray(record.estimate.base_T_correction.apply(record.scene.cloud), dtype=np.float64)
