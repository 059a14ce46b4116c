"""Every invalid submission gets an error with a remedy, over REST and gRPC, and leaves the session unchanged."""

from __future__ import annotations

import copy
import dataclasses
import json
from collections.abc import Callable
from typing import Any

import httpx
import numpy as np
import pytest
from helpers.box_session import DEPTH, MASK, ROOMY, measured, request
from helpers.problems import TIMEOUT, check, code_of, over_grpc, over_rest
from helpers.processes import Orchestrator

from pretouch.client import RestClient
from pretouch.errors import (
    Conflict,
    InvalidInput,
    Malformed,
    NotFound,
    PretouchError,
    TooLarge,
    UnsupportedMedia,
)
from pretouch.session import Budget, ScanPlan, Session
from pretouch.tof import MAX_SAMPLES
from pretouch.v1 import orchestrator_pb2 as pb
from pretouch.wire.common import array_from_proto, array_to_proto
from pretouch.wire.json import submission_to_json
from pretouch.wire.session import submission_to_proto


@pytest.fixture(scope="module")
def session(orchestrator: Orchestrator) -> Session:
    """A session that waits for its first scan; nothing in this module moves it on."""
    with RestClient(orchestrator.rest_url) as client:
        return client.create_session(request(budget=Budget(**ROOMY)), DEPTH, MASK)


def rest_with(plan: ScanPlan, **changes: Any) -> dict[str, Any]:
    """The scan's JSON, the members of its second sample changed."""
    document = copy.deepcopy(submission_to_json(measured(plan)))
    document["samples"][1] |= changes
    return document


def grpc_with(plan: ScanPlan, column: str, value: Any) -> pb.SubmitScanRequest:
    """The scan's message, one column's second entry changed."""
    message = submission_to_proto("", plan.scan_id, measured(plan))
    packed = getattr(message.samples, column)
    values = array_from_proto(packed, column).copy()
    values[1] = value
    packed.CopyFrom(array_to_proto(values, "u1" if column in ("status", "module") else "f8"))
    return message


def many(count: int) -> np.ndarray:
    return np.zeros((count, 3))


def points(values: np.ndarray) -> pb.SubmitScanRequest:
    return pb.SubmitScanRequest(points=pb.Points(points=array_to_proto(values, "f8")))


def span(start: float, end: float, device: str = "finger") -> pb.SubmitScanRequest:
    fields: dict[str, Any] = {"device": device, "from": start, "to": end}
    return pb.SubmitScanRequest(gateway=pb.GatewaySpan(**fields))


CROOKED = np.diag([2.0, 1.0, 1.0, 1.0])
LEANING = {"translation": [0, 0, 0], "rotation": [0, 0, 0.7, 0.7]}
NOWHERE = {"translation": [0, np.nan, 0], "rotation": [0, 0, 0, 1]}
LOST = np.eye(4)
LOST[1, 3] = np.nan


@dataclasses.dataclass(frozen=True)
class Bad:
    """A bad scan on both wires, and the error that it deserves, with a word of its detail."""

    kind: type[PretouchError]
    word: str
    rest: Callable[[ScanPlan], Any]
    grpc: Callable[[ScanPlan], pb.SubmitScanRequest]


BAD = {
    "nothing": Bad(InvalidInput, "", lambda _: {}, lambda _: pb.SubmitScanRequest()),
    "no samples": Bad(
        InvalidInput,
        "empty",
        lambda _: {"samples": []},
        lambda _: pb.SubmitScanRequest(samples=_no_samples()),
    ),
    "no points": Bad(InvalidInput, "empty", lambda _: {"points": []}, lambda _: points(many(0))),
    "out of order": Bad(
        InvalidInput, "samples[2].t", lambda plan: rest_with(plan, t=1e6), lambda plan: grpc_with(plan, "t", 1e6)
    ),
    "negative range": Bad(
        InvalidInput,
        "samples[1].range",
        lambda plan: rest_with(plan, range=-0.01),
        lambda plan: grpc_with(plan, "range", -0.01),
    ),
    "range that the sensor cannot give": Bad(
        InvalidInput,
        "range_min",
        lambda plan: rest_with(plan, range=0.001, status=0),
        lambda plan: grpc_with(plan, "range", 0.001),
    ),
    "module that is not there": Bad(
        InvalidInput, "module", lambda plan: rest_with(plan, module=3), lambda plan: grpc_with(plan, "module", 3)
    ),
    "NaN time": Bad(Malformed, "", lambda plan: rest_with(plan, t=np.nan), lambda plan: grpc_with(plan, "t", np.nan)),
    "infinite range": Bad(
        Malformed, "", lambda plan: rest_with(plan, range=np.inf), lambda plan: grpc_with(plan, "range", np.inf)
    ),
    "NaN pose": Bad(
        Malformed,
        "",
        lambda plan: rest_with(plan, base_T_tip=NOWHERE),
        lambda plan: grpc_with(plan, "base_t_tip", LOST),
    ),
    "pose that is none": Bad(
        InvalidInput,
        "samples[1].base_T_tip",
        lambda plan: rest_with(plan, base_T_tip=LEANING),
        lambda plan: grpc_with(plan, "base_t_tip", CROOKED),
    ),
    "NaN point": Bad(
        Malformed, "", lambda _: {"points": [[0, 0, np.nan]]}, lambda _: points(np.array([[0, 0, np.nan]]))
    ),
    "points of two numbers": Bad(
        InvalidInput, "points", lambda _: {"points": [[0, 0]]}, lambda _: points(np.zeros((1, 2)))
    ),
    "too many points": Bad(
        TooLarge,
        str(MAX_SAMPLES + 1),
        lambda _: {"points": many(MAX_SAMPLES + 1).tolist()},
        lambda _: points(many(MAX_SAMPLES + 1)),
    ),
    "span that ends before it starts": Bad(
        InvalidInput,
        "gateway",
        lambda _: {"gateway": {"device": "finger", "from": 2, "to": 1}},
        lambda _: span(2, 1),
    ),
    "span of an unknown device": Bad(
        NotFound,
        "thumb",
        lambda _: {"gateway": {"device": "thumb", "from": 1, "to": 2}},
        lambda _: span(1, 2, "thumb"),
    ),
    "skipped for no known reason": Bad(
        InvalidInput,
        "bored",
        lambda _: {"skipped": "bored"},
        lambda _: pb.SubmitScanRequest(skipped=pb.Skipped(reason="bored")),
    ),
}


def _no_samples() -> Any:
    columns = {"t": (0,), "base_t_tip": (0, 4, 4), "range": (0,)}
    message = pb.SubmitScanRequest().samples
    for name, shape in columns.items():
        getattr(message, name).CopyFrom(array_to_proto(np.zeros(shape), "f8"))
    for name in ("status", "module"):
        getattr(message, name).CopyFrom(array_to_proto(np.zeros(0), "u1"))
    return message


def sent(document: Any) -> dict[str, Any]:
    """Options of an HTTP request with this JSON body, NaN and all."""
    return {"content": json.dumps(document).encode(), "headers": {"content-type": "application/json"}}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_scan_is_the_same_problem_on_both_wires(name: str, session: Session, orchestrator: Orchestrator) -> None:
    bad, plan = BAD[name], session.next_scan
    assert plan is not None
    path = f"/v1/sessions/{session.id}/scans/{plan.scan_id}"
    document, _ = over_rest(orchestrator, "POST", path, **sent(bad.rest(plan)))
    check(document, bad.kind, bad.word)
    message = bad.grpc(plan)
    message.session_id, message.scan_id = session.id, plan.scan_id
    document, code = over_grpc(orchestrator, "SubmitScan", message)
    check(document, bad.kind, bad.word)
    assert code is code_of(bad.kind)
    with RestClient(orchestrator.rest_url) as client:
        after = client.session(session.id)
    assert after.next_scan is not None
    assert after.next_scan.scan_id == plan.scan_id
    assert after.budget_used.scans == 0


def test_too_many_samples_are_too_large(session: Session, orchestrator: Orchestrator) -> None:
    assert session.next_scan is not None
    sample = submission_to_json(measured(session.next_scan))["samples"][0]
    path = f"/v1/sessions/{session.id}/scans/{session.next_scan.scan_id}"
    document, _ = over_rest(orchestrator, "POST", path, **sent({"samples": [sample] * (MAX_SAMPLES + 1)}))
    check(document, TooLarge, str(MAX_SAMPLES + 1))


def test_a_body_that_is_not_json_is_malformed(session: Session, orchestrator: Orchestrator) -> None:
    assert session.next_scan is not None
    path = f"/v1/sessions/{session.id}/scans/{session.next_scan.scan_id}"
    for body in (b"", b"{", b"\xff\xfe", b"[" * 100_000):
        document, _ = over_rest(orchestrator, "POST", path, content=body, headers={"content-type": "application/json"})
        check(document, Malformed, "JSON")
    document, _ = over_rest(orchestrator, "POST", path, content=b"{}", headers={"content-type": "text/plain"})
    check(document, UnsupportedMedia, "text/plain")


def test_an_unknown_scan_or_session_is_not_found(session: Session, orchestrator: Orchestrator) -> None:
    assert session.next_scan is not None
    good = measured(session.next_scan)
    for session_id, scan_id in ((session.id, "scan-of-another-day"), ("session-of-another-day", "scan-1")):
        path = f"/v1/sessions/{session_id}/scans/{scan_id}"
        document, _ = over_rest(orchestrator, "POST", path, **sent(submission_to_json(good)))
        check(document, NotFound, "of-another-day")
        document, code = over_grpc(orchestrator, "SubmitScan", submission_to_proto(session_id, scan_id, good))
        check(document, NotFound, "of-another-day")
        assert code is code_of(NotFound)


def test_a_scan_for_an_ended_session_conflicts(orchestrator: Orchestrator) -> None:
    with RestClient(orchestrator.rest_url) as client:
        session = client.create_session(request(budget=Budget(**ROOMY)), DEPTH, MASK)
        client.cancel(session.id)
    assert session.next_scan is not None
    scan_id, good = session.next_scan.scan_id, measured(session.next_scan)
    document, _ = over_rest(
        orchestrator, "POST", f"/v1/sessions/{session.id}/scans/{scan_id}", **sent(submission_to_json(good))
    )
    check(document, Conflict, "cancelled")
    document, code = over_grpc(orchestrator, "SubmitScan", submission_to_proto(session.id, scan_id, good))
    check(document, Conflict, "cancelled")
    assert code is code_of(Conflict)


def test_a_scan_once_answered_answers_again_whatever_the_body(orchestrator: Orchestrator) -> None:
    with RestClient(orchestrator.rest_url) as client:
        session = client.create_session(request(budget=Budget(**ROOMY)), DEPTH, MASK)
        assert session.next_scan is not None
        client.submit(session.id, session.next_scan.scan_id, measured(session.next_scan))
    path = f"{orchestrator.rest_url}/v1/sessions/{session.id}/scans/{session.next_scan.scan_id}"
    for body in (b"{}", b"nonsense", b'{"samples": [NaN]}'):
        response = httpx.post(
            path, content=body, headers={"content-type": "application/json"}, timeout=TIMEOUT, trust_env=False
        )
        assert response.status_code == 200
        assert response.json()["budget_used"]["scans"] == 1
