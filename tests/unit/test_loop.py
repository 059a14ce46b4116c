"""A session in memory, against a finger that scans the true world and services that answer by formula."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import numpy as np
import pytest
from helpers.loop_fakes import (
    CORRECTION,
    DEPTH,
    MASK,
    FormulaRegistrar,
    RandomDetector,
    answer,
    asked,
    misses,
    opened,
    samples_of,
)
from pretouch_orchestrator.sessions.endings import end_session
from pretouch_orchestrator.sessions.loop import Loop
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.sessions.transitions import get_pending_plan

from pretouch.errors import Conflict, Internal, InvalidInput, NotFound, Unavailable, problem
from pretouch.estimate import point_error
from pretouch.geometry import Pose
from pretouch.prior import PosePrior, Prior
from pretouch.session import (
    Budget,
    Planner,
    Points,
    Proposer,
    SessionRequest,
    Skipped,
    State,
    Tolerance,
)
from pretouch.tof import RangeSamples


def run(loop: Loop, request: SessionRequest) -> Record:
    record = opened(loop, request)
    while not record.state.ended:
        record = answer(loop, record, samples_of(record))
    return record


def test_a_session_converges_on_the_correction() -> None:
    record = run(Loop(RandomDetector(), FormulaRegistrar()), asked())
    assert record.state is State.CONVERGED
    assert record.next_scan is None
    assert record.estimate.error_quantile <= record.request.tolerance.error
    assert record.estimate.base_T_correction.is_close(CORRECTION)
    assert record.budget_used.scans == len(record.scans) == len(record.measured) > 0
    assert record.budget_used.seconds == pytest.approx(sum(scan.duration for scan in record.scans))
    assert 0 < record.budget_used.fraction <= record.request.budget.fraction
    assert all(0 < scan.returns <= scan.samples for scan in record.scans)


def test_a_new_session_waits_for_its_first_scan_with_the_prior_as_its_estimate() -> None:
    detector = RandomDetector()
    record = opened(Loop(detector, FormulaRegistrar()), asked(proposer=Proposer.NARF, budget=Budget(fraction=1.0)))
    assert record.state is State.AWAITING_SCAN
    assert record.proposer is Proposer.NARF
    assert record.next_scan is not None
    assert record.next_scan.path.t[0] == 0
    assert record.estimate.base_T_correction.is_close(Pose.identity())
    assert all(region.expected_error < record.estimate.expected_error for region in record.regions)
    assert record.next_scan.expected_returns == 1.0


def test_a_session_starts_from_the_mean_of_its_prior_and_plans_over_it() -> None:
    stds = np.array([0.01, 0.01, 0.01, 0.003, 0.003, 0.003])
    prior = PosePrior(Pose.from_rotation_vector((0.0, 0.1, 0.2), (0.05, -0.08, 0.06)), np.diag(stds**2))
    usual = opened(Loop(RandomDetector(), FormulaRegistrar()), asked(budget=Budget(fraction=1.0)))
    record = opened(Loop(RandomDetector(), FormulaRegistrar()), asked(prior=prior, budget=Budget(fraction=1.0)))
    assert record.prior is prior
    assert record.estimate.base_T_correction.is_close(prior.mean)
    np.testing.assert_array_equal(record.estimate.covariance, prior.covariance)
    assert record.next_scan is not None
    assert usual.next_scan is not None
    tips, down = record.next_scan.path.base_T_tip[:, :3, 3], record.next_scan.path.base_T_tip[:, :3, 2]
    table = record.scene.table.moved(prior.mean)
    np.testing.assert_allclose(down, np.tile(-table.normal, (len(down), 1)), atol=1e-9)
    over = np.linalg.norm(tips - prior.mean.apply(record.scene.centroid), axis=1)
    assert over.max() < 0.3
    lowest = usual.scene.table.height(usual.next_scan.path.base_T_tip[:, :3, 3]).min()
    assert table.height(tips).min() < lowest


def test_a_prior_that_the_samples_contradict_is_said_and_one_that_they_confirm_is_not() -> None:
    for offset, told in ((0.03, True), (0.0005, False)):
        mean = Pose.from_rotation_vector((0, 0, 0), (offset, 0, 0)) @ CORRECTION
        prior = PosePrior(mean, np.diag(np.array([0.01, 0.01, 0.01, 0.003, 0.003, 0.003]) ** 2))
        loop = Loop(RandomDetector(), FormulaRegistrar(gain=1e-3))
        record = opened(loop, asked(prior=prior, budget=Budget(fraction=1.0)))
        assert record.warnings == ()
        record = answer(loop, record, samples_of(record))
        assert [warning.code for warning in record.warnings] == ["prior-contradicted"] * told
        if told:
            assert "30.0 mm and 0.0 degrees" in record.warnings[0].detail


def test_a_prior_whose_mean_is_elsewhere_opens_no_session() -> None:
    prior = PosePrior(Pose.from_rotation_vector((0, 0, 0), (0.6, 0, 0)), 1e-4 * np.eye(6))
    with pytest.raises(InvalidInput, match=r"moves the object by 0\.6 m"):
        opened(Loop(RandomDetector(), FormulaRegistrar()), asked(prior=prior))


def test_services_see_the_object_and_its_surroundings_only_and_regions_are_in_the_clients_pixels() -> None:
    detector = RandomDetector()
    record = opened(Loop(detector, FormulaRegistrar()), asked())
    assert detector.scene is record.scene
    u0, v0 = record.origin
    h, w = record.scene.mask.shape
    assert h * w < MASK.size
    np.testing.assert_array_equal(record.scene.mask, MASK[v0 : v0 + h, u0 : u0 + w])
    v, u = np.nonzero(MASK)
    for region in record.regions:
        assert u.min() <= region.rectangle.x <= u.max() + 1
        assert v.min() <= region.rectangle.y <= v.max() + 1


def test_the_confidence_planner_keeps_the_proposers_order() -> None:
    loop = Loop(RandomDetector(), FormulaRegistrar(gain=1e-4))
    record = run(loop, asked(planner=Planner.CONFIDENCE, budget=Budget(scans=4, seconds=1000, fraction=1.0)))
    assert record.state is State.EXHAUSTED
    assert [scan.region_id for scan in record.scans] == ["region-1", "region-2", "region-3", "region-4"]


def test_the_object_is_found_when_no_mask_is_sent() -> None:
    loop = Loop(RandomDetector(), FormulaRegistrar())
    record = asyncio.run(loop.open("s", 0.0, asked(table=None), DEPTH, None))
    u0, v0 = record.origin
    h, w = record.scene.mask.shape
    found = np.zeros_like(MASK)
    found[v0 : v0 + h, u0 : u0 + w] = record.scene.mask
    assert (found & MASK).sum() / (found | MASK).sum() > 0.85


@pytest.mark.parametrize(
    ("budget", "spent"),
    [
        (Budget(scans=2), "scans"),
        (Budget(seconds=9.0), "seconds"),
        (Budget(fraction=0.25, scans=1000), "fraction"),
        (Budget(seconds=0.1), "seconds"),
        (Budget(fraction=0.001), "fraction"),
    ],
)
def test_no_scan_is_planned_beyond_a_budget(budget: Budget, spent: str) -> None:
    loop = Loop(RandomDetector(), FormulaRegistrar(gain=1e-4))
    record = run(loop, asked(budget=budget, planner=Planner.CONFIDENCE))
    assert record.state is State.EXHAUSTED
    assert record.budget_used.scans <= budget.scans
    assert record.budget_used.seconds <= budget.seconds
    assert record.budget_used.fraction <= budget.fraction + 0.02
    assert record.reason is not None
    assert record.reason["type"] == f"urn:pretouch:problem:{spent}"


def test_without_a_region_the_confidence_planner_has_nothing_to_scan() -> None:
    record = opened(Loop(RandomDetector(count=0), FormulaRegistrar()), asked(planner=Planner.CONFIDENCE))
    assert record.state is State.EXHAUSTED
    assert record.next_scan is None


def test_without_a_region_lines_across_the_object_are_scanned() -> None:
    record = run(Loop(RandomDetector(count=0), FormulaRegistrar()), asked())
    assert record.state is State.CONVERGED
    assert {scan.path_id[:5] for scan in record.scans} == {"line-"}
    assert {scan.region_id for scan in record.scans} == {None}


def test_a_session_whose_prior_is_good_enough_has_converged_at_once() -> None:
    loop = Loop(RandomDetector(), FormulaRegistrar())
    request = asked(prior=Prior(1e-4, 1e-3), budget=Budget(seconds=0.01))
    assert opened(loop, request).state is State.CONVERGED


def test_a_session_converges_even_with_the_scan_that_spends_its_budget() -> None:
    record = run(Loop(RandomDetector(), FormulaRegistrar(gain=10)), asked(budget=Budget(scans=1)))
    assert record.state is State.CONVERGED


def test_the_tolerances_own_confidence_decides() -> None:
    loop = Loop(RandomDetector(), FormulaRegistrar(gain=1e-9))
    prior = Prior(0.001, 0.005)
    scene = opened(loop, asked(prior=prior)).scene
    _, (low, middle, high) = point_error(prior.covariance, scene.cloud, scene.centroid, (0.5, 0.95, 0.99))
    for confidence, limit in ((0.5, low), (0.95, middle), (0.99, high)):
        for factor, state in ((1.001, State.CONVERGED), (0.999, State.AWAITING_SCAN)):
            tolerance = Tolerance(float(limit * factor), confidence)
            assert opened(loop, asked(prior=prior, tolerance=tolerance)).state is state


def test_a_scan_of_misses_counts_as_a_scan() -> None:
    loop = Loop(RandomDetector(), FormulaRegistrar())
    record = answer(loop, opened(loop, asked()), misses(30))
    assert record.state is State.AWAITING_SCAN
    assert record.budget_used.scans == 1
    assert record.budget_used.fraction == 0
    assert record.scans[0].samples == 30
    assert record.scans[0].returns == 0
    assert len(record.measured[0]) == 30


def test_a_robot_may_send_points() -> None:
    loop = Loop(RandomDetector(), FormulaRegistrar())
    record = opened(loop, asked())
    points = samples_of(record).beams(record.request.sensor).points()
    by_points = answer(loop, record, Points(points))
    by_samples = answer(loop, record, samples_of(record))
    assert by_points.estimate.expected_error == by_samples.estimate.expected_error
    assert by_points.scans[0].samples == by_points.scans[0].returns == len(points)
    assert by_points.budget_used.fraction == by_samples.budget_used.fraction


def test_a_scan_that_took_longer_than_planned_costs_what_it_took() -> None:
    loop = Loop(RandomDetector(), FormulaRegistrar())
    record = answer(loop, opened(loop, asked()), misses(5, span=60.0))
    assert record.budget_used.seconds == record.scans[0].duration == 60.0


@pytest.mark.parametrize("planner", list(Planner))
def test_a_skipped_scan_neither_counts_nor_changes_the_estimate_and_its_path_is_not_planned_again(
    planner: Planner,
) -> None:
    loop = Loop(RandomDetector(count=4), FormulaRegistrar())
    record = opened(loop, asked(planner=planner))
    first = record
    tried = []
    while not record.state.ended:
        assert record.next_scan is not None
        tried.append(record.next_scan.path_id)
        record = answer(loop, record, Skipped(samples_of(record)))
    assert record.state is State.EXHAUSTED
    assert len(set(tried)) == len(tried)
    assert {region.id for region in record.regions} <= set(tried)
    assert record.budget_used == first.budget_used
    assert record.estimate is first.estimate
    assert record.scans == record.measured == ()
    assert record.skipped == tuple(tried)


@pytest.mark.parametrize(
    "nothing",
    [misses(0), Points(np.zeros((0, 3))), replace(misses(3), module=np.ones(3, dtype=int))],
    ids=["no samples", "no points", "no such module"],
)
def test_an_unusable_scan_leaves_the_session_as_it_was(nothing: RangeSamples | Points) -> None:
    loop = Loop(RandomDetector(), FormulaRegistrar())
    record = opened(loop, asked())
    with pytest.raises(InvalidInput):
        answer(loop, record, nothing)
    assert answer(loop, record, samples_of(record)).budget_used.scans == 1


def test_a_registrar_that_is_away_leaves_the_session_as_it_was() -> None:
    registrar = FormulaRegistrar()
    loop = Loop(RandomDetector(), registrar)
    record = opened(loop, asked())
    registrar.down = True
    with pytest.raises(Unavailable):
        answer(loop, record, samples_of(record))
    registrar.down = False
    assert answer(loop, record, samples_of(record)).budget_used.scans == 1


def test_a_path_of_which_nothing_returned_is_not_planned_again() -> None:
    loop = Loop(RandomDetector(count=2), FormulaRegistrar())
    record = opened(loop, asked())
    for _ in range(6):
        assert record.next_scan is not None
        assert record.next_scan.path_id not in {scan.path_id for scan in record.scans}
        record = answer(loop, record, misses(30))


def test_scan_ids_unknown_answered_and_late() -> None:
    loop = Loop(RandomDetector(), FormulaRegistrar(gain=1e-3))
    record = opened(loop, asked())
    first = record.next_scan
    assert first is not None
    with pytest.raises(NotFound):
        asyncio.run(loop.advance(record, "nonsense", misses(3)))
    assert get_pending_plan(record, first.scan_id) is first
    after = answer(loop, record, samples_of(record))
    assert after.next_scan is not None
    assert after.next_scan.scan_id != first.scan_id
    assert asyncio.run(loop.advance(after, first.scan_id, misses(0))) is after
    cancelled = end_session(after, State.CANCELLED)
    assert cancelled.state is State.CANCELLED
    assert cancelled.next_scan is None
    assert asyncio.run(loop.advance(cancelled, first.scan_id, misses(3))) is cancelled
    with pytest.raises(Conflict):
        asyncio.run(loop.advance(cancelled, after.next_scan.scan_id, misses(3)))
    with pytest.raises(Conflict):
        get_pending_plan(cancelled, after.next_scan.scan_id)


def test_a_fault_ends_a_session_with_its_reason_and_an_end_is_final() -> None:
    loop = Loop(RandomDetector(), FormulaRegistrar())
    record = opened(loop, asked())
    failed = end_session(record, State.FAILED, problem(Internal("A defect.", "Report it.")))
    assert failed.state is State.FAILED
    assert failed.reason is not None
    assert failed.reason["detail"] == "A defect."
    assert end_session(failed, State.CANCELLED) is failed
    cancelled = end_session(record, State.CANCELLED)
    assert cancelled.reason is None
    assert end_session(cancelled, State.FAILED, problem(Internal("Late."))) is cancelled


def test_the_same_request_gives_the_same_session() -> None:
    loop = Loop(RandomDetector(), FormulaRegistrar())
    a, b = (run(loop, asked()) for _ in range(2))
    assert [scan.path_id for scan in a.scans] == [scan.path_id for scan in b.scans]
    assert a.estimate.expected_error == b.estimate.expected_error
    assert a.budget_used == b.budget_used
