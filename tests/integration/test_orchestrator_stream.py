"""A whole session on one gRPC stream."""

from __future__ import annotations

import queue
from collections.abc import Iterator
from typing import Any

import grpc
import httpx
import numpy as np
import pytest
from helpers import box_view
from helpers.processes import Orchestrator
from helpers.rest_sessions import opened
from helpers.told_scans import NOTHING

from pretouch.channel import open_sync_channel
from pretouch.errors import PretouchError, from_rpc_error
from pretouch.session import SampleChunk
from pretouch.tof import RangeSamples
from pretouch.v1 import orchestrator_pb2 as pb
from pretouch.v1.orchestrator_pb2_grpc import OrchestratorServiceStub
from pretouch.wire import json, session

TIMEOUT = 60


@pytest.fixture(scope="module")
def stub(orchestrator: Orchestrator) -> Iterator[Any]:
    with open_sync_channel(orchestrator.address) as channel:
        yield OrchestratorServiceStub(channel)


class Run:
    """A RunSession call: `ask` sends a step and gives the session that comes back."""

    def __init__(self, stub: Any) -> None:
        self._steps: queue.Queue[pb.RunSessionRequest | None] = queue.Queue()
        self._answers = stub.RunSession(iter(self._steps.get, None), timeout=TIMEOUT, wait_for_ready=True)

    def ask(self, **step: Any) -> pb.Session:
        return self.step(**step).session

    def step(self, **step: Any) -> pb.RunSessionResponse:
        self._steps.put(pb.RunSessionRequest(**step))
        return next(self._answers)

    def end(self) -> list[Any]:
        """Nothing more is asked; what still comes back."""
        self._steps.put(None)
        return list(self._answers)


def creation() -> pb.CreateSessionRequest:
    depth, mask = box_view.depth_and_mask()
    return session.request_to_proto(json.request_from_json(box_view.request(budget={"fraction": 1.0})), depth, mask)


def scan(answer: pb.Session) -> pb.SubmitScanRequest:
    path = session.scan_plan_from_proto(answer.next_scan).path
    n = len(path.t)
    samples = RangeSamples(path.t, path.base_T_tip, np.full(n, 0.03), np.zeros(n), np.zeros(n))
    return session.submission_to_proto("", answer.next_scan.scan_id, samples)


def refused(run: Run, **step: Any) -> PretouchError:
    with pytest.raises(grpc.RpcError) as error:
        run.ask(**step)
    return from_rpc_error(error.value)


def test_a_session_runs_to_its_end_on_one_stream(stub: Any) -> None:
    run = Run(stub)
    answer = run.ask(create=creation())
    while answer.HasField("next_scan"):
        answer = run.ask(scan=scan(answer))
    assert answer.state == pb.SESSION_STATE_CONVERGED
    assert len(answer.scans) == 3
    assert run.end() == []


def test_a_stream_takes_up_a_session_that_rest_opened(stub: Any, rest: httpx.Client) -> None:
    opened_by_rest = opened(rest)
    run = Run(stub)
    answer = run.ask(session_id=opened_by_rest["id"])
    assert answer.next_scan.scan_id == opened_by_rest["next_scan"]["scan_id"]
    answer = run.ask(scan=scan(answer))
    assert run.end() == []
    now = rest.get(f"/v1/sessions/{answer.id}").json()
    assert json.session_to_json(session.session_from_proto(answer)) == now


def test_samples_of_a_scan_under_way_are_answered_with_its_progress(stub: Any) -> None:
    run = Run(stub)
    answer = run.ask(create=creation())
    samples = session.submission_from_proto(scan(answer))
    assert isinstance(samples, RangeSamples)
    scan_id = answer.next_scan.scan_id
    for start, end in ((0, 2), (0, 3)):
        chunk = SampleChunk(start, samples.select(slice(start, end)))
        told = run.step(samples=session.telling_to_proto("", scan_id, chunk))
        assert (told.HasField("session"), told.progress.told) == (False, end)
    rest = samples.select(slice(3, None))
    answer = run.ask(scan=session.submission_to_proto("", scan_id, rest))
    assert answer.scans[0].samples == len(samples)
    late = session.telling_to_proto("", scan_id, SampleChunk(0, samples))
    assert "closed" in refused(run, samples=late).detail


def test_samples_before_a_session_or_for_another_are_refused(stub: Any) -> None:
    answer = Run(stub).ask(create=creation())
    foreign = session.telling_to_proto("another", answer.next_scan.scan_id, SampleChunk(0, NOTHING))
    assert "first" in refused(Run(stub), samples=foreign).remedy
    run = Run(stub)
    run.ask(session_id=answer.id)
    assert "another" in refused(run, samples=foreign).detail


def test_steps_out_of_order_are_refused(stub: Any) -> None:
    answer = Run(stub).ask(create=creation())
    assert "first" in refused(Run(stub), scan=scan(answer)).remedy
    assert "first" in refused(Run(stub)).remedy
    run = Run(stub)
    run.ask(session_id=answer.id)
    assert "create" in refused(run, create=creation()).detail
    run = Run(stub)
    run.ask(session_id=answer.id)
    foreign = scan(answer)
    foreign.session_id = "another"
    assert "another" in refused(run, scan=foreign).detail
    assert "nobody" in refused(Run(stub), session_id="nobody").detail


def test_a_stream_that_waits_for_a_scan_ends_when_the_service_stops(stub: Any, orchestrator: Orchestrator) -> None:
    run = Run(stub)
    answer = run.ask(create=creation())
    assert orchestrator.stop() == 0
    assert run.end() == []
    orchestrator.start()
    assert Run(stub).ask(session_id=answer.id) == answer
