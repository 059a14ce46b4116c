"""A session's events over REST and gRPC: replayed, resumed, live, and closed at the end."""

from __future__ import annotations

import json
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import grpc
import httpx
import pytest
from helpers.processes import Orchestrator
from helpers.rest_sessions import assert_problem, opened, scanned

from pretouch.channel import open_sync_channel
from pretouch.v1 import orchestrator_pb2 as pb
from pretouch.v1.orchestrator_pb2_grpc import OrchestratorServiceStub


def parsed(lines: Iterator[str]) -> Iterator[tuple[int, str, Any]]:
    """Id, type and data of each server-sent event."""
    fields: dict[str, str] = {}
    for line in lines:
        if line and not line.startswith(":"):
            name, _, value = line.partition(": ")
            fields[name] = value
        elif fields:
            yield int(fields["id"]), fields["event"], json.loads(fields["data"])
            fields = {}


def replayed(rest: httpx.Client, session: dict[str, Any], after: str | None = None) -> list[tuple[int, str, Any]]:
    headers = {} if after is None else {"Last-Event-ID": after}
    response = rest.get(f"/v1/sessions/{session['id']}/events", headers=headers)
    assert response.headers["content-type"].startswith("text/event-stream")
    return list(parsed(iter(response.text.splitlines())))


def converged(rest: httpx.Client) -> dict[str, Any]:
    session = opened(rest)
    while session["next_scan"]:
        session = scanned(rest, session)
    return session


def test_an_ended_session_is_told_from_its_start(rest: httpx.Client) -> None:
    session = converged(rest)
    events = replayed(rest, session)
    step = ["scan", "estimate", "session"]
    assert [kind for _, kind, _ in events] == ["session", "estimate", *step, *step, *step, "end"]
    assert [number for number, _, _ in events] == list(range(1, len(events) + 1))
    assert [data for _, kind, data in events if kind == "scan"] == session["scans"]
    assert [data for _, kind, data in events if kind == "session"][-1] == session
    assert [data for _, kind, data in events if kind == "estimate"][-1] == session["estimate"]
    assert events[-1][2] == {"state": "converged"}


def test_a_stream_resumes_after_the_last_event_that_came(rest: httpx.Client) -> None:
    session = converged(rest)
    events = replayed(rest, session)
    assert replayed(rest, session, "4") == events[4:]
    assert replayed(rest, session, str(events[-1][0])) == []
    assert replayed(rest, session, "999999") == []
    for wrong in ("x", "-1", "1.5", "9" * 30):
        answer = rest.get(f"/v1/sessions/{session['id']}/events", headers={"Last-Event-ID": wrong})
        assert_problem(answer, 400, "Last-Event-ID")


def test_live_events_reach_every_follower_once(rest: httpx.Client, orchestrator: Orchestrator) -> None:
    session = opened(rest)
    url = f"{orchestrator.rest_url}/v1/sessions/{session['id']}/events"
    with httpx.stream("GET", url, timeout=60) as one, httpx.stream("GET", url, timeout=60) as two:
        streams = [parsed(one.iter_lines()), parsed(two.iter_lines())]
        for stream in streams:
            assert [next(stream)[1] for _ in range(2)] == ["session", "estimate"]
        session = scanned(rest, session)
        for stream in streams:
            assert [next(stream)[0] for _ in range(3)] == [3, 4, 5]
        rest.delete(f"/v1/sessions/{session['id']}")
        for stream in streams:
            assert [kind for _, kind, _ in stream] == ["session", "end"]


def test_grpc_tells_the_same(rest: httpx.Client, orchestrator: Orchestrator) -> None:
    session = converged(rest)
    expected = replayed(rest, session)
    with open_sync_channel(orchestrator.address) as channel:
        stub = OrchestratorServiceStub(channel)
        for after in (0, 4):
            request = pb.StreamEventsRequest(session_id=session["id"], after=after)
            events = [(each.id, each.type, json.loads(each.data)) for each in stub.StreamEvents(request, timeout=30)]
            assert events == expected[after:]
        with pytest.raises(grpc.RpcError) as error:
            list(stub.StreamEvents(pb.StreamEventsRequest(session_id="nobody"), timeout=30))
        assert error.value.code() is grpc.StatusCode.NOT_FOUND


def test_many_followers_that_left_do_not_hold_the_session_up(rest: httpx.Client, orchestrator: Orchestrator) -> None:
    session = opened(rest)
    url = f"{orchestrator.rest_url}/v1/sessions/{session['id']}/events"

    def leave_after_one_line(_: int) -> str:
        with httpx.stream("GET", url, timeout=60) as stream:
            return next(stream.iter_lines())

    with ThreadPoolExecutor(8) as pool:
        assert set(pool.map(leave_after_one_line, range(24))) == {"id: 1"}
    assert scanned(rest, session)["scans"]
