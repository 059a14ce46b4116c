"""What was answered survives SIGKILL; what was not is simply posted again."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import httpx
import pytest
from helpers import box_view
from helpers.fake_upstream import FakeUpstream
from helpers.processes import Orchestrator
from helpers.rest_sessions import assert_problem, opened, scan_path, scanned

from pretouch.wire.common import array_from_proto


def events(rest: httpx.Client, session_id: str) -> list[tuple[int, str]]:
    """Ids and types of an ended session's events."""
    text = rest.get(f"/v1/sessions/{session_id}/events").text
    fields = [dict(line.split(": ", 1) for line in block.splitlines()) for block in text.split("\n\n") if block]
    return [(int(event["id"]), event["event"]) for event in fields]


def test_a_session_goes_on_with_the_same_plan_after_a_kill(
    rest: httpx.Client, orchestrator: Orchestrator, fakes: FakeUpstream
) -> None:
    key = {"Idempotency-Key": "before the kill"}
    files = box_view.multipart(budget={"fraction": 1.0})
    session = rest.post("/v1/sessions", files=files, headers=key).json()
    session = scanned(rest, session)
    other = opened(rest)
    rest.delete(f"/v1/sessions/{other['id']}")

    orchestrator.kill()
    orchestrator.start()

    assert rest.get(f"/v1/sessions/{session['id']}").json() == session
    assert rest.get(f"/v1/sessions/{other['id']}").json()["state"] == "cancelled"
    assert rest.post("/v1/sessions", files=files, headers=key).json() == session
    while session["state"] == "awaiting_scan":
        session = scanned(rest, session)
    assert session["state"] == "converged"
    step = ["scan", "estimate", "session"]
    assert events(rest, session["id"]) == list(enumerate(["session", "estimate", *step, *step, *step, "end"], start=1))
    assert len(fakes.calls[-1].request.scans) == 3, "the last estimate uses the scan from before the kill too"


def test_a_scan_under_way_at_the_kill_is_posted_again(
    rest: httpx.Client, orchestrator: Orchestrator, fakes: FakeUpstream
) -> None:
    session = opened(rest)
    with ThreadPoolExecutor(1) as pool:
        with fakes.held("Register"):
            answer = pool.submit(scanned, rest, session)
            fakes.wait_for_call("Register")
            orchestrator.kill()
        with pytest.raises(httpx.TransportError):
            answer.result(60)
    orchestrator.start()
    assert rest.get(f"/v1/sessions/{session['id']}").json() == session
    assert len(scanned(rest, session)["scans"]) == 1


def test_samples_told_survive_a_kill_and_another_client_goes_on(
    rest: httpx.Client, orchestrator: Orchestrator, fakes: FakeUpstream
) -> None:
    session = opened(rest)
    path = f"{scan_path(session)}/samples"
    samples = box_view.samples(session["next_scan"])["samples"]
    for start, end in ((0, 2), (1, 3)):
        told = rest.post(path, json={"from": start, "samples": samples[start:end]})
        assert told.json()["told"] == end, told.text

    orchestrator.kill()
    orchestrator.start()

    with httpx.Client(base_url=orchestrator.rest_url, timeout=60) as other:
        assert other.get(f"/v1/sessions/{session['id']}").json() == session
        assert other.post(path, json={"from": 0, "samples": []}).json()["told"] == 3
        assert_problem(other.post(path, json={"from": 4, "samples": samples[4:]}), 409, "told is 3")
        assert other.post(path, json={"from": 2, "samples": samples[2:4]}).json()["told"] == 4
        closed = other.post(scan_path(session), json={"samples": samples[4:]}).json()
    assert closed["scans"][0]["samples"] == len(samples)
    registered = [call.request for call in fakes.calls if call.method == "Register"][-1]
    assert len(array_from_proto(registered.scans[-1].ranges, "ranges")) == len(samples)


def test_a_telling_under_way_at_the_kill_is_told_again(
    rest: httpx.Client, orchestrator: Orchestrator, fakes: FakeUpstream
) -> None:
    session = opened(rest)
    path = f"{scan_path(session)}/samples"
    first = box_view.samples(session["next_scan"])["samples"][0]
    body = {"from": 0, "samples": [first | {"t": k / 30} for k in range(30)]}
    with fakes.held("Register"):
        told = rest.post(path, json=body).json()
        fakes.wait_for_call("Register")
        orchestrator.kill()
    assert (told["told"], told["enough"]) == (30, False)
    orchestrator.start()
    registrations = fakes.count("Register")
    assert rest.post(path, json=body).json()["told"] == 30
    while fakes.count("Register") == registrations:
        rest.post(path, json={"from": 0, "samples": []})
    closed = rest.post(scan_path(session), json={"samples": []}).json()
    assert closed["scans"][0]["samples"] == 30


def test_a_stop_lets_a_scan_under_way_end_and_closes_streams(
    rest: httpx.Client, orchestrator: Orchestrator, fakes: FakeUpstream
) -> None:
    session = opened(rest)
    with ThreadPoolExecutor(2) as pool:
        with rest.stream("GET", f"/v1/sessions/{session['id']}/events") as stream:
            lines = stream.iter_lines()
            assert next(lines) == "id: 1"
            with fakes.held("Register"):
                answer = pool.submit(scanned, rest, session)
                fakes.wait_for_call("Register")
                stopped = pool.submit(orchestrator.stop)
                orchestrator.logged("stopping")
            seen = list(lines)
        assert len(answer.result(60)["scans"]) == 1
        assert stopped.result(60) == 0
    assert "event: end" not in seen
    orchestrator.start()
    assert len(rest.get(f"/v1/sessions/{session['id']}").json()["scans"]) == 1
