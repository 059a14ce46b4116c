"""A session converges only if its estimate explains the samples, and otherwise ends with a reason."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.loop_fakes import FormulaRegistrar, RandomDetector, answer, asked, misses, opened, samples_of
from pretouch_orchestrator.sessions.endings import end_session
from pretouch_orchestrator.sessions.loop import Loop
from pretouch_orchestrator.sessions.record import Record

from pretouch.client import Reflex
from pretouch.session import Budget, Planner, ScanSettings, Skipped, State, Tolerance
from pretouch.trajectory import Trajectory

STUCK = "All 96 ranges are 31.2 mm: the sensor is stuck."
SURE = 10.0
"""A gain by which one scan meets the tolerance."""


def scan(loop: Loop, record: Record) -> Record:
    return answer(loop, record, samples_of(record))


def exhausted(record: Record) -> dict[str, Any]:
    """The reason, after its kind was checked for what all have in common."""
    assert record.state is State.EXHAUSTED
    assert record.next_scan is None
    assert record.reason is not None
    assert record.to_session().reason == record.reason
    assert record.reason.keys() == {"type", "title", "status", "detail", "remedy"}
    assert all(record.reason.values())
    assert record.reason["status"] == 409
    assert re.search(r"\d", record.reason["detail"])
    return record.reason


@pytest.mark.parametrize(("fit", "state"), [(0.01, State.CONVERGED), (0.0099, State.AWAITING_SCAN)])
def test_samples_that_the_answer_does_not_explain_keep_a_session_from_converging(fit: float, state: State) -> None:
    loop = Loop(RandomDetector(), FormulaRegistrar(SURE, fit))
    record = scan(loop, opened(loop, asked()))
    assert record.estimate.error_quantile <= record.request.tolerance.error
    assert record.state is state


def test_a_misfit_goes_on_to_the_end_of_the_budget_and_is_then_the_reason() -> None:
    loop = Loop(RandomDetector(), FormulaRegistrar(SURE, fit=2e-5))
    record = opened(loop, asked(budget=Budget(scans=3, seconds=1e5, fraction=1.0)))
    while not record.state.ended:
        record = scan(loop, record)
    assert len(record.scans) == 3
    reason = exhausted(record)
    assert reason["type"].endswith(":misfit")
    assert f"{record.estimate.samples} samples" in reason["detail"]
    assert "2e-05" in reason["detail"]


def test_a_misfit_that_later_samples_explain_is_forgotten() -> None:
    registrar = FormulaRegistrar(SURE, fit=1e-9)
    loop = Loop(RandomDetector(), registrar)
    record = scan(loop, opened(loop, asked()))
    registrar.fit = 0.5
    assert scan(loop, record).state is State.CONVERGED


def test_samples_that_are_no_measurements_twice_in_a_row_end_the_session() -> None:
    loop = Loop(RandomDetector(), FormulaRegistrar(SURE, sensor_problem=STUCK))
    record = scan(loop, opened(loop, asked()))
    assert record.state is State.AWAITING_SCAN
    record = answer(loop, record, Skipped())
    assert record.state is State.AWAITING_SCAN
    reason = exhausted(scan(loop, record))
    assert reason["type"].endswith(":sensor")
    assert STUCK in reason["detail"]
    assert "2 scans" in reason["detail"]


def test_a_sensor_that_measures_again_is_forgiven() -> None:
    registrar = FormulaRegistrar(1e-4, sensor_problem=STUCK)
    loop = Loop(RandomDetector(), registrar)
    record = scan(loop, opened(loop, asked(budget=Budget(fraction=1.0))))
    for problem in ("", STUCK, ""):
        registrar.sensor_problem = problem
        record = scan(loop, record)
        assert record.state is State.AWAITING_SCAN


def test_a_session_that_got_nothing_back_was_out_of_range() -> None:
    loop = Loop(RandomDetector(), FormulaRegistrar())
    record = opened(loop, asked(budget=Budget(scans=2)))
    for _ in range(2):
        record = answer(loop, record, misses(30))
    reason = exhausted(record)
    assert reason["type"].endswith(":out-of-range")
    assert "None of the 60 samples of 2 scans" in reason["detail"]
    assert "100 mm" in reason["detail"]


def test_a_robot_whose_reflex_lifts_the_tip_off_every_path_is_sent_elsewhere_until_the_session_ends() -> None:
    loop = Loop(RandomDetector(4), FormulaRegistrar())
    record = opened(loop, asked(scan=ScanSettings(guarded=True)))
    paths: list[Trajectory] = []
    while record.next_scan is not None:
        path = record.next_scan.path
        assert not any(np.array_equal(path.base_T_tip, other.base_T_tip) for other in paths)
        paths.append(path)
        reflex, tips = Reflex(lift=0.1), path.sampled(30.0)
        lifted = np.stack([reflex.raise_tip(pose) for pose in tips.base_T_tip])
        record = answer(loop, record, replace(misses(len(tips.t)), t=tips.t, base_T_tip=lifted))
    assert 2 <= len(paths) == len(record.scans) <= record.request.budget.scans
    assert exhausted(record)["type"].endswith(":out-of-range")


def test_one_return_is_enough_to_be_within_range() -> None:
    loop = Loop(RandomDetector(), FormulaRegistrar(1e-9))
    record = answer(loop, opened(loop, asked(budget=Budget(scans=2))), misses(30))
    assert exhausted(scan(loop, record))["type"].endswith(":scans")


@pytest.mark.parametrize(
    ("fit", "problem", "returned", "kind"),
    [
        (0.0, STUCK, True, "sensor"),
        (0.0, "", True, "misfit"),
        (1.0, "", False, "out-of-range"),
        (1.0, "", True, "scans"),
    ],
)
def test_the_gravest_reason_is_the_one_that_is_said(fit: float, problem: str, returned: bool, kind: str) -> None:
    loop = Loop(RandomDetector(), FormulaRegistrar(1e-9, fit, problem))
    record = opened(loop, asked(budget=Budget(scans=1)))
    record = answer(loop, record, samples_of(record) if returned else misses(30))
    assert exhausted(record)["type"] == f"urn:pretouch:problem:{kind}"


@pytest.mark.parametrize(
    ("budget", "numbers"),
    [
        (Budget(scans=1, seconds=1e5, fraction=1.0), "1 of 1 scan."),
        (Budget(seconds=0.1), "0.0 of 0.1 robot seconds"),
        (Budget(fraction=0.002), "0.0% of the object is scanned, and another scan would exceed the 0.2% allowed"),
    ],
    ids=["scans", "seconds", "fraction"],
)
def test_a_budget_that_is_spent_is_named_with_its_numbers(
    request: pytest.FixtureRequest, budget: Budget, numbers: str
) -> None:
    loop = Loop(RandomDetector(), FormulaRegistrar(1e-9))
    record = opened(loop, asked(budget=budget, tolerance=Tolerance(0.002)))
    while not record.state.ended:
        record = scan(loop, record)
    reason = exhausted(record)
    name = request.node.callspec.id
    assert reason["type"].endswith(f":{name}")
    assert numbers in reason["detail"]
    assert f"{1000 * record.estimate.error_quantile:.1f} mm; 2 mm were requested" in reason["detail"]
    assert f"budget.{name}" in reason["remedy"]


def test_a_session_that_has_no_region_left_has_nothing_to_gain() -> None:
    loop = Loop(RandomDetector(count=3), FormulaRegistrar(1e-9))
    record = opened(loop, asked(budget=Budget(20, 1e5, 1.0), planner=Planner.CONFIDENCE))
    record = answer(loop, record, Skipped())
    while not record.state.ended:
        record = scan(loop, record)
    reason = exhausted(record)
    assert reason["type"].endswith(":nothing-to-gain")
    assert "After 2 scans, and 1 path that the finger could not reach, no further scan" in reason["detail"]


def test_an_end_keeps_its_reason() -> None:
    loop = Loop(RandomDetector(count=0), FormulaRegistrar())
    record = opened(loop, asked(planner=Planner.CONFIDENCE))
    assert exhausted(record)["type"].endswith(":nothing-to-gain")
    assert end_session(record, State.CANCELLED) is record
