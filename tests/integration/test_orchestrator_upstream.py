"""Upstream services that are away, busy, wrong or slow: the session stays as it was, and the client is told why."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx
import pytest
from helpers import box_view
from helpers.fake_upstream import FakeUpstream
from helpers.processes import Orchestrator
from helpers.rest_sessions import assert_problem, opened, scan_path, scanned

from pretouch.errors import DeadlineExceeded, Internal, InvalidInput, Overloaded, Unauthenticated, Unavailable


def test_an_upstream_that_stays_away_is_unavailable_and_the_scan_can_be_repeated(
    rest: httpx.Client, fakes: FakeUpstream
) -> None:
    session = opened(rest)
    body = box_view.samples(session["next_scan"])
    fakes.stop()
    with ThreadPoolExecutor(2) as pool:
        scan = pool.submit(rest.post, scan_path(session), json=body)
        creation = pool.submit(rest.post, "/v1/sessions", files=box_view.multipart())
        assert_problem(rest.get("/readyz"), 503, "detector", "registrar", "sensor gateway")
        assert_problem(scan.result(60), 503, "registrar", "repeat")
        assert_problem(creation.result(60), 503, "detector")
    assert rest.get("/healthz").status_code == 200
    assert rest.get(f"/v1/sessions/{session['id']}").json() == session
    fakes.start()
    assert len(scanned(rest, session)["scans"]) == 1
    assert rest.get("/readyz").status_code == 200


def test_a_restart_of_an_upstream_goes_unnoticed(rest: httpx.Client, fakes: FakeUpstream) -> None:
    session = opened(rest)
    fakes.stop()
    with ThreadPoolExecutor(1) as pool:
        answer = pool.submit(scanned, rest, session)
        fakes.start()
        assert len(answer.result(60)["scans"]) == 1


@pytest.mark.parametrize("error", [Overloaded("busy", "wait"), Unavailable("warming up", "wait")])
def test_a_busy_upstream_is_asked_again(rest: httpx.Client, fakes: FakeUpstream, error: Overloaded) -> None:
    session = opened(rest)
    registered = fakes.count("Register")
    fakes.fail("Register", error, times=3)
    assert len(scanned(rest, session)["scans"]) == 1
    assert fakes.count("Register") == registered + 4


@pytest.mark.parametrize(
    ("error", "status"), [(InvalidInput("odd scene", "mend it"), 422), (DeadlineExceeded("too slow", "wait"), 504)]
)
def test_what_an_upstream_finds_wrong_is_passed_on(
    rest: httpx.Client, fakes: FakeUpstream, error: InvalidInput, status: int
) -> None:
    session = opened(rest)
    fakes.fail("Register", error)
    answer = rest.post(scan_path(session), json=box_view.samples(session["next_scan"]))
    assert_problem(answer, status, error.detail)
    assert rest.get(f"/v1/sessions/{session['id']}").json() == session


def test_an_upstream_that_refuses_our_token_is_our_fault_not_the_clients(
    rest: httpx.Client, fakes: FakeUpstream
) -> None:
    session = opened(rest)
    fakes.fail("Register", Unauthenticated("wrong token", "send the right one"))
    answer = rest.post(scan_path(session), json=box_view.samples(session["next_scan"]))
    assert_problem(answer, 503, "registrar", "token")


def test_a_defect_upstream_fails_the_session_with_its_reason(rest: httpx.Client, fakes: FakeUpstream) -> None:
    session = opened(rest)
    fakes.fail("Register", Internal("the registrar met a defect", "report it"))
    after = scanned(rest, session)
    assert after["state"] == "failed"
    assert after["reason"]["status"] == 500
    assert after["reason"]["detail"] == "the registrar met a defect"
    assert after["next_scan"] is None
    assert "event: end" in rest.get(f"/v1/sessions/{session['id']}/events").text


def test_upstream_calls_carry_the_session_and_the_scan(rest: httpx.Client, fakes: FakeUpstream) -> None:
    session = opened(rest)
    proposed = [call for call in fakes.calls if call.method == "Propose"][-1]
    assert proposed.metadata["pretouch-session-id"] == session["id"]
    scan_id = session["next_scan"]["scan_id"]
    scanned(rest, session)
    registered = [call for call in fakes.calls if call.method == "Register"][-1]
    assert registered.metadata["pretouch-session-id"] == session["id"]
    assert registered.metadata["pretouch-scan-id"] == scan_id


def test_a_proposer_that_is_not_ready_is_refused_with_those_that_are(rest: httpx.Client, fakes: FakeUpstream) -> None:
    answer = rest.post("/v1/sessions", files=box_view.multipart(proposer="deep"))
    assert_problem(answer, 503, "'deep'", "no weights", "stability, narf, random")
    assert opened(rest, proposer="narf")["proposer"] == "narf"


def test_without_a_gateway_its_spans_are_refused_and_all_else_works(tmp_path: Path, fakes: FakeUpstream) -> None:
    with (
        Orchestrator(tmp_path, fakes.address, gateway=False) as orchestrator,
        httpx.Client(base_url=orchestrator.rest_url, timeout=60) as rest,
    ):
        assert rest.get("/readyz").status_code == 200
        session = opened(rest)
        span = {"gateway": {"device": "", "from": 0.0, "to": 1.0}}
        assert_problem(rest.post(scan_path(session), json=span), 503, "PRETOUCH_ORCHESTRATOR_GATEWAY")
        assert scanned(rest, session)["scans"]


def test_a_client_that_gave_up_finds_its_scan_counted(rest: httpx.Client, fakes: FakeUpstream) -> None:
    session = opened(rest)
    registered = fakes.count("Register")
    hasty = httpx.Timeout(60, read=0.2)
    with ThreadPoolExecutor(1) as pool, fakes.held("Register"):
        body = box_view.samples(session["next_scan"])
        answer = pool.submit(rest.post, scan_path(session), json=body, timeout=hasty)
        fakes.wait_for_call("Register")
        with pytest.raises(httpx.ReadTimeout):
            answer.result(60)
    assert len(scanned(rest, session)["scans"]) == 1
    assert fakes.count("Register") == registered + 1
