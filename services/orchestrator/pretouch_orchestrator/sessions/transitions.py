"""The session's state machine: pure functions that derive a new record from an old one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pretouch.errors import Conflict, NotFound
from pretouch.estimate import Estimate
from pretouch.geometry import vector_from_rotation
from pretouch.session import Planner, Points, ScanPlan, ScanSummary
from pretouch.session_warning import SessionWarning
from pretouch.tof import RangeSamples, Scan
from pretouch_orchestrator.perception.scan_check import check_points, check_samples
from pretouch_orchestrator.perception.sensor_check import diagnose, drop_modules, summarize
from pretouch_orchestrator.planning.candidates import (
    FIRST_PIECES,
    MAX_NEARBY,
    NEARBY,
    PIECES,
    CandidatePath,
    plan_nearby_paths,
    plan_object_paths,
)
from pretouch_orchestrator.planning.coverage import find_scanned
from pretouch_orchestrator.planning.path import PathPlanner
from pretouch_orchestrator.planning.planner import Need, Option, choose, shortlist
from pretouch_orchestrator.planning.surroundings import BEYOND
from pretouch_orchestrator.sessions.endings import error_quantile
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.sessions.told import measure_flight


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
    """The submission without the samples of faulty modules, and what is wrong with them ("" if there are none)."""
    if isinstance(submission, Points):
        return submission, ""
    diagnoses = diagnose(submission, record.request.sensor, record.scene, record.estimate, record.measured)
    kept = drop_modules(submission, [diagnosis.module for diagnosis in diagnoses])
    return kept, summarize(diagnoses) if diagnoses else ""


def inspect_submission(record: Record, plan: ScanPlan, submission: RangeSamples | Points) -> list[SessionWarning]:
    """What is odd about the whole scan; raises `InvalidInput` if it cannot be of the plan."""
    if isinstance(submission, Points):
        return check_points(submission, plan, record.scene)
    return check_samples(submission, plan, record.scene, record.request.sensor)


def warn_of_faults(plan: ScanPlan, faults: str) -> list[SessionWarning]:
    """That samples of the scan were left out because of `faults`; nothing if there are none."""
    if not faults:
        return []
    return [
        SessionWarning(
            "samples-left-out",
            f"In {plan.scan_id}: {faults} These samples are left out.",
            "Look at what the finger sends with `pretouch gateway watch`; check its cable and supply, tip_T_module and "
            "the unit of its ranges.",
        )
    ]


def warn_of_contradiction(record: Record, estimate: Estimate) -> list[SessionWarning]:
    """That the samples contradict the session's prior, without which the estimate was then made; nothing if not."""
    prior, centroid = record.prior, estimate.centroid
    if not prior.is_contradicted_by(estimate.base_T_correction, centroid, estimate.covariance):
        return []
    apart = np.linalg.norm(estimate.base_T_correction.apply(centroid) - prior.mean.apply(centroid))
    turn = vector_from_rotation(estimate.base_T_correction.rotation @ prior.mean.rotation.T)
    return [
        SessionWarning(
            "prior-contradicted",
            f"The finger finds the object {1000 * apart:.1f} mm and {np.degrees(np.linalg.norm(turn)):.1f} degrees "
            f"from where the prior puts it, which states {1000 * prior.translation_std:.2g} mm and "
            f"{np.degrees(prior.rotation_std):.2g} degrees. The estimate is made without it.",
            "Check whether the camera was moved, and that the prior's covariance is in the order rotation vector, "
            "translation, in rad and m, and not too small.",
        )
    ]


def scan_from_submission(record: Record, submission: RangeSamples | Points) -> Scan:
    """The submission as beams in base.

    Raises:
        InvalidInput: it does not fit the session's sensor.
    """
    if isinstance(submission, Points):
        down = -record.scene.table.moved(record.estimate.base_T_correction).normal
        return Scan.of_points(submission.points, down)
    return submission.beams(record.request.sensor)


def apply_scan(
    record: Record, plan: ScanPlan, submission: RangeSamples | Points, scan: Scan, estimate: Estimate
) -> Record:
    """Adds a scan to the session: its beams, its summary and its cost.

    Args:
        submission: all that the client sent, samples that it told before included.
        scan: the part of it that is used.
        estimate: the estimate from all scans, this one included.
    """
    flight = measure_flight(record, plan, submission)
    summary = ScanSummary(
        scan_id=plan.scan_id,
        path_id=plan.path_id,
        region_id=plan.region_id,
        samples=len(submission) if isinstance(submission, RangeSamples) else len(scan),
        returns=int(scan.returned.sum()),
        length=flight.length,
        duration=flight.duration,
        expected_error=estimate.expected_error,
    )
    record = replace(
        record,
        estimate=estimate,
        scans=(*record.scans, summary),
        measured=(*record.measured, scan),
        answered=(*record.answered, plan.scan_id),
        next_scan=None,
        told=(),
    )
    budget_used = replace(
        record.budget_used,
        scans=len(record.scans),
        seconds=record.budget_used.seconds + flight.duration,
        fraction=float(find_scanned(record.corrected_cloud(), record.measured).mean()),
    )
    return replace(record, budget_used=budget_used)


def skip_scan(record: Record, plan: ScanPlan) -> Record:
    """Closes a scan that the robot could not make: it costs nothing, and its path is not planned again.

    Samples that were told of it are dropped.
    """
    return replace(
        record,
        skipped=(*record.skipped, plan.path_id),
        answered=(*record.answered, plan.scan_id),
        next_scan=None,
        told=(),
    )


def plan_over_object(record: Record) -> list[CandidatePath]:
    """The paths over the object that are still open."""
    planner = PathPlanner(record.scene, record.estimate, record.request.scan)
    pieces: tuple[float, ...] = ()
    if record.request.planner is Planner.INFORMATION:
        pieces = PIECES if record.registrable_scans else FIRST_PIECES
    regions = [replace(region, rectangle=record.to_scene(region.rectangle)) for region in record.regions]
    return plan_object_paths(planner, regions, pieces, _list_closed(record))


def _list_closed(record: Record) -> set[str]:
    """Ids of the paths that are not planned again: skipped ones, and those of which a scan returned nothing.

    The confidence planner plans no path twice.
    """
    whole = record.request.planner is Planner.CONFIDENCE
    return {*record.skipped, *(scan.path_id for scan in record.scans if whole or not scan.returns)}


def plan_nearby(record: Record) -> list[CandidatePath]:
    """The paths beside the object that are still open and that the seconds left allow.

    None after MAX_NEARBY of them: what those could not tell, further ones will not tell either.
    """
    if sum(scan.path_id.startswith(NEARBY) for scan in record.scans) >= MAX_NEARBY:
        return []
    planner = PathPlanner(record.scene, record.estimate, record.request.scan, BEYOND)
    paths = plan_nearby_paths(record.scene, planner, record.request.sensor.range_max, _list_closed(record))
    left = record.request.budget.seconds - record.budget_used.seconds
    return [path for path in paths if path.path.duration <= left]


def update_regions(record: Record, options: Sequence[Option]) -> Record:
    """Updates each region's expected error to that after a scan of as much of its perimeter as the options hold.

    A scan of any other region is taken to leave the error as it is.
    """
    present = record.estimate.expected_error
    longest: dict[str, Option] = {}
    for option in options:
        region = option.candidate.region_id
        if region is not None and (region not in longest or option.seconds > longest[region].seconds):
            longest[region] = option
    predicted = {region: option.prediction.expected_error for region, option in longest.items()}
    regions = tuple(replace(region, expected_error=predicted.get(region.id, present)) for region in record.regions)
    return replace(record, regions=regions)


def shortlist_options(record: Record, options: Sequence[Option]) -> list[Option]:
    """The best of the options, to be predicted more carefully."""
    return shortlist(options, record.request.planner, _describe_need(record))


def choose_option(record: Record, options: Sequence[Option]) -> Option | None:
    """The best of the options; None if none is worth making."""
    return choose(options, record.request.planner, _describe_need(record))


def is_predicted(record: Record, options: Sequence[Option]) -> bool:
    """Whether the registrar's engine predicts errors: one that cannot foretells the present one of all scans."""
    present = record.estimate.expected_error
    return any(option.prediction.expected_error != present for option in options)


def choose_unpredicted(record: Record, options: Sequence[Option]) -> Option | None:
    """The best by the proposer's confidence of the visible options over regions that have not been scanned."""
    scanned = {scan.region_id for scan in record.scans}
    fresh = [each for each in options if each.visible and each.candidate.region_id not in {None, *scanned}]
    return choose(fresh, Planner.CONFIDENCE, _describe_need(record))


def plan_scan(record: Record, option: Option) -> Record:
    """Plans the scan."""
    candidate = option.alone()
    plan = ScanPlan(
        scan_id=f"scan-{len(record.answered) + 1}",
        path_id=candidate.id,
        region_id=candidate.region_id,
        path=candidate.path,
        expected_returns=option.prediction.expected_returns,
    )
    return replace(record, next_scan=plan)


def _describe_need(record: Record) -> Need:
    return Need(
        record.estimate.expected_error,
        float(np.log(error_quantile(record) / record.request.tolerance.error)),
        record.request.budget.scans - record.budget_used.scans,
    )
