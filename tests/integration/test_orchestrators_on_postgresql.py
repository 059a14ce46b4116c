"""Two real orchestrators on one real PostgreSQL: any of them serves any session, and each may die at any time."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import httpx
import pytest
from helpers import box_view
from helpers.fake_upstream import FakeUpstream
from helpers.postgresql import PostgresqlServer
from helpers.processes import Orchestrator
from helpers.rest_sessions import assert_problem, opened, scan_path, scanned


class Robot(httpx.Client):
    """A client of one of the orchestrators."""

    def __init__(self, orchestrator: Orchestrator) -> None:
        super().__init__(base_url=orchestrator.rest_url, timeout=60)
        self.orchestrator = orchestrator


@pytest.fixture(scope="module")
def robots(
    tmp_path_factory: pytest.TempPathFactory, fakes: FakeUpstream, postgresql: PostgresqlServer
) -> Iterator[list[Robot]]:
    """A client of each; both orchestrators start at once on an empty database."""
    address = postgresql.new_database()
    folder: Path = tmp_path_factory.mktemp("no state")
    services = [Orchestrator(folder, fakes.address, PRETOUCH_ORCHESTRATOR_STORE=address) for _ in range(2)]
    with ThreadPoolExecutor(2) as pool, ExitStack() as stack:
        for started in [pool.submit(service.start) for service in services]:
            started.result()
        for service in services:
            stack.callback(service.stop)
        yield [stack.enter_context(Robot(service)) for service in services]


def samples(session: dict[str, Any]) -> dict[str, Any]:
    return box_view.samples(session["next_scan"])


def test_a_session_goes_to_and_fro_and_its_events_are_told_by_both(robots: list[Robot]) -> None:
    a, b = robots
    session, sent = opened(a), []
    with a.stream("GET", f"/v1/sessions/{session['id']}/events") as stream:
        lines = stream.iter_lines()
        assert next(lines) == "id: 1"
        for robot in (b, a, b, a, b):
            if session["next_scan"]:
                sent.append(len(samples(session)["samples"]))
                path, body = scan_path(session), samples(session)
                for start in (0, 2):
                    told = (a, b)[start // 2].post(
                        f"{path}/samples", json={"from": start, "samples": body["samples"][start : start + 2]}
                    )
                    assert told.json()["told"] == start + 2, told.text
                session = robot.post(path, json={"samples": body["samples"][4:]}).json()
        kinds = [line.removeprefix("event: ") for line in lines if line.startswith("event: ")]
    assert session["state"] == "converged"
    assert [scan["samples"] for scan in session["scans"]] == sent
    assert kinds == ["session", "estimate", *["scan", "estimate", "session"] * len(sent), "end"]
    assert [robot.get(f"/v1/sessions/{session['id']}").json() for robot in robots] == [session] * 2


def test_a_scan_sent_to_both_at_once_is_registered_once(robots: list[Robot], fakes: FakeUpstream) -> None:
    session = opened(robots[0])
    before = fakes.count("Register")
    with ThreadPoolExecutor(4) as pool:
        with fakes.held("Register"):
            answers = [pool.submit(robot.post, scan_path(session), json=samples(session)) for robot in robots * 2]
            fakes.wait_for_call("Register")
        bodies = [answer.result(60).json() for answer in answers]
    assert fakes.count("Register") == before + 1
    assert bodies[1:] == bodies[:1] * 3
    assert len(bodies[0]["scans"]) == 1


def test_a_step_of_one_that_is_killed_is_taken_over_by_the_other(robots: list[Robot], fakes: FakeUpstream) -> None:
    a, b = robots
    session = opened(a)
    with ThreadPoolExecutor(2) as pool:
        with fakes.held("Register"):
            lost = pool.submit(a.post, scan_path(session), json=samples(session))
            fakes.wait_for_call("Register")
            waiting = pool.submit(b.post, scan_path(session), json=samples(session))
            a.orchestrator.kill()
            with pytest.raises(httpx.TransportError):
                lost.result(60)
        taken_over = waiting.result(60).json()
    assert len(taken_over["scans"]) == 1
    a.orchestrator.start()
    assert a.post(scan_path(session), json=samples(session)).json() == taken_over
    assert len(scanned(a, taken_over)["scans"]) == 2


def test_a_cancellation_at_one_stops_the_step_of_the_other_at_once(robots: list[Robot], fakes: FakeUpstream) -> None:
    a, b = robots
    for query in ("", "?purge=true"):
        session = opened(a)
        with ThreadPoolExecutor(1) as pool, fakes.held("Register"):
            step = pool.submit(a.post, scan_path(session), json=samples(session))
            fakes.wait_for_call("Register")
            assert b.delete(f"/v1/sessions/{session['id']}{query}").status_code == 204
            answer = step.result(60)
        if query:
            assert answer.status_code in (404, 409)
            assert_problem(a.get(f"/v1/sessions/{session['id']}"), 404, "no session")
            assert_problem(a.delete(f"/v1/sessions/{session['id']}"), 404, "no session")
        else:
            assert_problem(answer, 409, "cancelled")
            assert a.get(f"/v1/sessions/{session['id']}").json()["state"] == "cancelled"


def test_a_key_sent_to_both_at_once_opens_one_session(robots: list[Robot], fakes: FakeUpstream) -> None:
    files, key = box_view.multipart(), {"Idempotency-Key": "sent to both"}
    with ThreadPoolExecutor(4) as pool:
        answers = list(pool.map(lambda robot: robot.post("/v1/sessions", files=files, headers=key), robots * 2))
    assert [answer.status_code for answer in answers] == [201] * 4
    assert len({answer.json()["id"] for answer in answers}) == 1


def test_a_crash_of_the_database_loses_nothing_that_was_answered(
    robots: list[Robot], postgresql: PostgresqlServer
) -> None:
    sessions = [scanned(robot, opened(robot)) for robot in robots]
    with robots[0].stream("GET", f"/v1/sessions/{sessions[0]['id']}/events") as stream:
        lines = stream.iter_lines()
        assert next(lines) == "id: 1"
        postgresql.stop()
        try:
            for robot, session in zip(robots, sessions, strict=True):
                refused = robot.post(scan_path(session), json=samples(session))
                assert_problem(refused, 503, "session store")
                assert int(refused.headers["Retry-After"]) >= 1
                assert_problem(robot.get("/readyz"), 503, "session store")
        finally:
            postgresql.start()
        for robot, session in zip(reversed(robots), sessions, strict=True):
            assert robot.get(f"/v1/sessions/{session['id']}").json() == session
            assert len(scanned(robot, session)["scans"]) == 2
        robots[1].delete(f"/v1/sessions/{sessions[0]['id']}")
        assert [line for line in lines if line.startswith("event: ")][-1] == "event: end"
    assert [robot.get("/readyz").status_code for robot in robots] == [200, 200]
