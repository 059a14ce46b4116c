"""The reason of a session that ends without converging, over REST and gRPC."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import httpx
import numpy as np
import pytest
from helpers.box_session import DEPTH, MASK, ROOMY, measured, request
from helpers.fake_upstream import FakeUpstream
from helpers.processes import Orchestrator

from pretouch.client import RestClient
from pretouch.estimate import Estimate, Mode
from pretouch.geometry import Pose
from pretouch.session import Budget, Planner, ScanPlan, ScanSettings, Session, Skipped, State, Submission, Tolerance

STUCK = "All 96 ranges are 31.2 mm: the sensor is stuck."
FAR = Pose.from_rotation_vector([0.0, 0.0, 0.5], [0.01, 0.02, 0.0])


def unchanged(estimate: Estimate) -> Estimate:
    return estimate


def misfit(estimate: Estimate) -> Estimate:
    return replace(estimate, fit=0.0004)


def stuck(estimate: Estimate) -> Estimate:
    return replace(estimate, sensor_problem=STUCK)


def ambiguous(estimate: Estimate) -> Estimate:
    return replace(estimate, modes=(Mode(estimate.base_T_correction, 0.75), Mode(FAR, 0.25)), fit=0.3)


def missed(plan: ScanPlan) -> Submission:
    samples = measured(plan)
    return replace(samples, range=np.full(len(samples), np.nan))


def skipped(plan: ScanPlan) -> Submission:
    return Skipped()


HIGH = ScanSettings(standoff=0.09)
"""From where nothing need come back."""
roomy = Budget(**ROOMY)
fine = Tolerance(error=1e-6)


@pytest.mark.parametrize(
    ("kind", "asked", "execute", "estimated", "scans", "said"),
    [
        ("scans", {"budget": Budget(1, 1e5, 1.0)}, measured, unchanged, 1, "1 of 1 scan"),
        ("seconds", {"budget": Budget(20, 0.01, 1.0)}, measured, unchanged, 0, "0.01 robot seconds"),
        ("fraction", {"budget": Budget(20, 1e5, 0.001)}, measured, unchanged, 0, "0.1% allowed"),
        ("nothing-to-gain", {"budget": roomy, "tolerance": fine}, measured, unchanged, 3, "After 3 scans"),
        ("nothing-to-gain", {"budget": roomy}, skipped, unchanged, 0, "and 3 paths that the finger could not reach"),
        ("out-of-range", {"budget": Budget(2, 1e5, 1.0), "scan": HIGH}, missed, unchanged, 2, "of 2 scans returned"),
        ("sensor", {"budget": roomy}, missed, unchanged, 2, "it is dead"),
        ("misfit", {"budget": roomy}, measured, misfit, 3, "0.0004"),
        ("sensor", {"budget": roomy}, measured, stuck, 2, "is stuck"),
    ],
)
async def test_an_exhausted_session_says_why(
    client: Any,
    fakes: FakeUpstream,
    kind: str,
    asked: dict[str, Any],
    execute: Callable[[ScanPlan], Submission],
    estimated: Callable[[Estimate], Estimate],
    scans: int,
    said: str,
) -> None:
    with fakes.estimating(estimated):
        session: Session = await client.create_session(request(planner=Planner.CONFIDENCE, **asked), DEPTH, MASK)
        while session.next_scan is not None:
            assert session.reason is None
            session = await client.submit(session.id, session.next_scan.scan_id, execute(session.next_scan))
    assert (session.state, len(session.scans)) == (State.EXHAUSTED, scans)
    reason = session.reason
    assert reason is not None
    assert reason["type"] == f"urn:pretouch:problem:{kind}"
    assert reason["status"] == 409
    assert said in reason["detail"]
    assert reason["title"]
    assert reason["remedy"]
    await client.cancel(session.id)
    after = await client.session(session.id)
    assert (after.state, after.reason) == (State.EXHAUSTED, reason)
    events = [event async for event in client.events(session.id)]
    assert events[-1].type == "end"
    assert events[-1].data == {"state": "exhausted", "reason": reason}


async def test_the_tolerance_is_not_enough_where_the_samples_fit_badly(client: Any, fakes: FakeUpstream) -> None:
    with fakes.estimating(misfit):
        session = await client.create_session(request(budget=roomy, tolerance=Tolerance(error=0.02)), DEPTH, MASK)
        session = await client.submit(session.id, session.next_scan.scan_id, measured(session.next_scan))
    assert session.estimate.error_quantile <= 0.02
    assert session.state is State.AWAITING_SCAN
    session = await client.submit(session.id, session.next_scan.scan_id, measured(session.next_scan))
    assert session.state is State.CONVERGED


async def test_an_estimate_names_its_modes_and_its_fit(client: Any, fakes: FakeUpstream) -> None:
    session = await client.create_session(request(budget=roomy), DEPTH, MASK)
    assert [mode.weight for mode in session.estimate.modes] == [1.0]
    assert session.estimate.fit == 1.0
    with fakes.estimating(ambiguous):
        session = await client.submit(session.id, session.next_scan.scan_id, measured(session.next_scan))
    assert [mode.weight for mode in session.estimate.modes] == [0.75, 0.25]
    assert session.estimate.modes[0].base_T_correction.is_close(session.estimate.base_T_correction)
    assert session.estimate.modes[1].base_T_correction.is_close(FAR)
    assert session.estimate.fit == 0.3


def test_the_json_of_an_estimate_has_the_members_of_the_contract(
    orchestrator: Orchestrator, fakes: FakeUpstream
) -> None:
    members = {"base_T_correction", "centroid", "covariance", "expected_error", "error_quantile", "unobservable"}
    members |= {"modes", "fit", "inliers", "samples", "rmse"}
    with RestClient(orchestrator.rest_url) as client, fakes.estimating(stuck):
        session = client.create_session(request(budget=roomy), DEPTH, MASK)
        client.submit(session.id, session.next_scan.scan_id, measured(session.next_scan))
    address = f"{orchestrator.rest_url}/v1/sessions/{session.id}"
    estimate = httpx.get(address, timeout=10, trust_env=False).json()["estimate"]
    assert estimate.keys() == members
    assert estimate["modes"] == [{"base_T_correction": estimate["base_T_correction"], "weight": 1.0}]
    assert estimate["fit"] == 1.0
