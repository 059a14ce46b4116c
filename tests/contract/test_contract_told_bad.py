"""Tellings that cannot be read are the same problem over REST and gRPC, and change nothing."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest
from helpers.box_session import DEPTH, MASK, ROOMY, measured, request
from helpers.problems import check, code_of, over_grpc, over_rest
from helpers.processes import Orchestrator

from pretouch.client import RestClient
from pretouch.errors import InvalidInput, Malformed, PretouchError, UnsupportedMedia
from pretouch.session import Budget, Session
from pretouch.v1 import orchestrator_pb2 as pb


@pytest.fixture(scope="module")
def session(orchestrator: Orchestrator) -> Session:
    """A session that waits for its first scan; nothing in this module moves it on."""
    with RestClient(orchestrator.rest_url) as client:
        return client.create_session(request(budget=Budget(**ROOMY)), DEPTH, MASK)


@dataclasses.dataclass(frozen=True)
class Bad:
    """A bad telling over REST and, where it can be said there, over gRPC; and its error, with a word of its detail."""

    kind: type[PretouchError]
    word: str
    rest: dict[str, Any]
    grpc: pb.TellSamplesRequest | None = None


def span(start: float, end: float) -> pb.TellSamplesRequest:
    fields: dict[str, Any] = {"device": "finger", "from": start, "to": end}
    return pb.TellSamplesRequest(gateway=pb.GatewaySpan(**fields))


BAD = {
    "nothing": Bad(InvalidInput, "", {}, pb.TellSamplesRequest()),
    "no start": Bad(InvalidInput, "from is missing", {"samples": []}),
    "no samples": Bad(InvalidInput, "samples is missing", {"from": 0}),
    "a start below 0": Bad(InvalidInput, "from is -1", {"from": -1, "samples": []}),
    "half a start": Bad(InvalidInput, "from is 0.5", {"from": 0.5, "samples": []}),
    "both": Bad(InvalidInput, "from", {"from": 0, "samples": [], "gateway": {"device": "", "from": 1, "to": 2}}),
    "a skipped scan": Bad(InvalidInput, "skipped", {"skipped": "unreachable"}),
    "a span that ends before it starts": Bad(
        InvalidInput, "gateway", {"gateway": {"device": "finger", "from": 2, "to": 1}}, span(2, 1)
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_telling_is_a_problem(name: str, session: Session, orchestrator: Orchestrator) -> None:
    bad = BAD[name]
    assert session.next_scan is not None
    path = f"/v1/sessions/{session.id}/scans/{session.next_scan.scan_id}/samples"
    document, _ = over_rest(orchestrator, "POST", path, json=bad.rest)
    check(document, bad.kind, bad.word)
    if bad.grpc is not None:
        message = pb.TellSamplesRequest(session_id=session.id, scan_id=session.next_scan.scan_id)
        message.MergeFrom(bad.grpc)
        document, code = over_grpc(orchestrator, "TellSamples", message)
        check(document, bad.kind, bad.word)
        assert code is code_of(bad.kind)


def test_what_is_no_json_is_malformed(session: Session, orchestrator: Orchestrator) -> None:
    assert session.next_scan is not None
    path = f"/v1/sessions/{session.id}/scans/{session.next_scan.scan_id}/samples"
    document, _ = over_rest(orchestrator, "POST", path, content=b"{", headers={"content-type": "application/json"})
    check(document, Malformed, "JSON")
    document, _ = over_rest(orchestrator, "POST", path, content=b"{}", headers={"content-type": "text/plain"})
    check(document, UnsupportedMedia, "text/plain")


def test_a_body_is_not_read_for_a_closed_scan(orchestrator: Orchestrator) -> None:
    with RestClient(orchestrator.rest_url) as client:
        opened = client.create_session(request(budget=Budget(**ROOMY)), DEPTH, MASK)
        assert opened.next_scan is not None
        client.submit(opened.id, opened.next_scan.scan_id, measured(opened.next_scan))
    path = f"/v1/sessions/{opened.id}/scans/{opened.next_scan.scan_id}/samples"
    document, _ = over_rest(orchestrator, "POST", path, content=b"{", headers={"content-type": "application/json"})
    assert (document["status"], "closed" in document["detail"]) == (409, True)
