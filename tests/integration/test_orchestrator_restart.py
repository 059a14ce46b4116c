"""What was answered survives SIGKILL; what was not is simply posted again."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import box_view
import httpx
import pytest
from fake_upstream import FakeUpstream
from processes import Orchestrator
from rest_sessions import opened, scan_path, scanned


def events(rest: httpx.Client, session_id: str) -> list[tuple[int, str]]:
    """Ids and types of an ended session's events."""
    text = rest.get(f"/v1/sessions/{session_id}/events").text
    fields = [dict(line.split(": ", 1) for line in block.splitlines()) for block in text.split("\n\n") if block]
    return [(int(event["id"]), event["event"]) for event in fields]


def test_a_session_goes_on_with_the_same_plan_after_a_kill(tmp_path: Path, upstream: FakeUpstream) -> None:
    with Orchestrator(tmp_path, upstream.address) as orchestrator, httpx.Client(timeout=60) as rest:
        rest.base_url = orchestrator.rest_url
        key = {"Idempotency-Key": "before"}
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
        session = scanned(rest, session)
        assert [scan["scan_id"] for scan in session["scans"]] == sorted({scan["scan_id"] for scan in session["scans"]})

        orchestrator.kill()
        orchestrator.start()

        session = scanned(rest, session)
        assert session["state"] == "converged"
        step = ["scan", "estimate", "session"]
        assert events(rest, session["id"]) == list(
            enumerate(["session", "estimate", *step, *step, *step, "end"], start=1)
        )
        beams = [len(scan.ranges.data) for scan in upstream.calls[-1].request.scans]
        assert len(beams) == 3, "the last estimate is made of all scans, those from before the kills too"


def test_a_scan_under_way_at_the_kill_is_posted_again(tmp_path: Path, upstream: FakeUpstream) -> None:
    with Orchestrator(tmp_path, upstream.address) as orchestrator, httpx.Client(timeout=60) as rest:
        rest.base_url = orchestrator.rest_url
        session = opened(rest)
        body = json.dumps(box_view.samples(session["next_scan"])).encode()
        with ThreadPoolExecutor(1) as pool:
            with upstream.held("Register"):
                answer = pool.submit(
                    httpx.post,
                    orchestrator.rest_url + scan_path(session),
                    content=body,
                    headers={"content-type": "application/json"},
                    timeout=60,
                )
                upstream.wait_for_call("Register")
                orchestrator.kill()
            with pytest.raises(httpx.TransportError):
                answer.result(60)
        orchestrator.start()
        assert rest.get(f"/v1/sessions/{session['id']}").json() == session
        after = scanned(rest, session)
        assert len(after["scans"]) == 1


def test_a_stop_lets_a_scan_under_way_end_and_closes_streams(tmp_path: Path, upstream: FakeUpstream) -> None:
    with Orchestrator(tmp_path, upstream.address) as orchestrator, httpx.Client(timeout=60) as rest:
        rest.base_url = orchestrator.rest_url
        session = opened(rest)
        with ThreadPoolExecutor(3) as pool:
            with rest.stream("GET", f"/v1/sessions/{session['id']}/events") as stream:
                lines = stream.iter_lines()
                assert next(lines) == "id: 1"
                with upstream.held("Register"):
                    answer = pool.submit(scanned, rest, session)
                    upstream.wait_for_call("Register")
                    stopped = pool.submit(orchestrator.stop)
                    orchestrator.logged("stopping")
                seen = list(lines)
            assert len(answer.result(60)["scans"]) == 1
            assert stopped.result(60) == 0
        assert "event: end" not in seen
        orchestrator.start()
        assert len(rest.get(f"/v1/sessions/{session['id']}").json()["scans"]) == 1


def test_a_second_orchestrator_on_the_same_state_says_why_it_ends(tmp_path: Path, upstream: FakeUpstream) -> None:
    second = Orchestrator(tmp_path, upstream.address)
    with (
        Orchestrator(tmp_path, upstream.address),
        pytest.raises(RuntimeError, match="Another orchestrator uses the state directory"),
    ):
        second.start()
