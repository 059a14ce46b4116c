"""All four clients retry where that helps, give up where it does not, and raise the library's own errors."""

import dataclasses
import email.utils
import math
import socket
import time
from collections.abc import Iterator

import numpy as np
import pytest
from helpers.client_kinds import KINDS, opened
from helpers.scripted_orchestrator import ScriptedOrchestrator

from pretouch.camera import Camera
from pretouch.client.rest_api import HttpAnswer, raise_for_problem, read_retry_after
from pretouch.client.retries import Attempts
from pretouch.errors import (
    Conflict,
    DeadlineExceeded,
    Internal,
    InvalidInput,
    NotFound,
    Overloaded,
    PretouchError,
    Unauthenticated,
    Unavailable,
    unreachable,
)
from pretouch.estimate import from_prior
from pretouch.geometry import Pose
from pretouch.prior import Prior
from pretouch.session import Planner, Proposer, ScanPlan, Session, SessionRequest, Skipped, State
from pretouch.trajectory import Trajectory

SESSION = Session(
    id="s1",
    state=State.AWAITING_SCAN,
    proposer=Proposer.RANDOM,
    planner=Planner.INFORMATION,
    regions=(),
    estimate=from_prior(Prior(), np.eye(3)),
    next_scan=ScanPlan("scan-1", "line-1", None, Trajectory(np.arange(2.0), np.tile(np.eye(4), (2, 1, 1))), 1.0),
)
ENDED = dataclasses.replace(SESSION, state=State.EXHAUSTED, next_scan=None)
REQUEST = SessionRequest(Camera(525, 525, 1, 1), Pose.identity())
DEPTH = np.ones((3, 3), np.uint16)

every_client = pytest.mark.parametrize("kind", KINDS)


@pytest.fixture
def script() -> Iterator[ScriptedOrchestrator]:
    with ScriptedOrchestrator(SESSION) as orchestrator:
        yield orchestrator


@every_client
@pytest.mark.parametrize(
    "error", [Unavailable("warming up", "wait", 0.0), Overloaded("busy", "wait", 0.0), DeadlineExceeded("late", "wait")]
)
async def test_a_passing_fault_is_tried_again(kind: str, error: PretouchError, script: ScriptedOrchestrator) -> None:
    script.errors = [error]
    async with opened(kind, script.rest_url, script.grpc_address) as client:
        assert (await client.submit("s1", "scan-1", Skipped())).id == "s1"
    assert len(script.calls) == 2


@every_client
async def test_creation_is_tried_again_under_one_key(kind: str, script: ScriptedOrchestrator) -> None:
    script.errors = [Unavailable("warming up", "wait", 0.0)]
    async with opened(kind, script.rest_url, script.grpc_address) as client:
        await client.create_session(REQUEST, DEPTH)
        await client.create_session(REQUEST, DEPTH, idempotency_key="mine")
    first, again, mine = script.keys
    assert first == again
    assert len(first) > 8
    assert mine == "mine"


def test_a_further_try_that_runs_out_of_time_tells_what_was_wrong_before() -> None:
    attempts = Attempts(60.0)
    attempts.delay_after(Unavailable("warming up", "wait"))
    with pytest.raises(Unavailable, match="warming up"):
        attempts.delay_after(DeadlineExceeded("too late", retry_after=math.inf))
    with pytest.raises(DeadlineExceeded):
        Attempts(60.0).delay_after(DeadlineExceeded("too late", retry_after=math.inf))


@pytest.mark.parametrize("error", [Overloaded("busy", "", 3.0), Unavailable("starting", "", 3.0)])
def test_a_service_that_says_when_is_asked_again_then_until_the_timeout(error: PretouchError) -> None:
    attempts = Attempts(60.0)
    delays = [attempts.delay_after(error) for _ in range(20)]
    assert all(3.0 <= delay <= 3.75 for delay in delays)
    assert len(set(delays)) > 1
    with pytest.raises(type(error)):
        attempts.delay_after(type(error)("busy", "", 61.0))
    with pytest.raises(type(error)):
        attempts.delay_after(type(error)("it will not pass", "", math.inf))


def test_a_service_that_was_never_reached_is_tried_six_times() -> None:
    attempts, others = Attempts(60.0), Attempts(60.0)
    for _ in range(5):
        assert attempts.delay_after(unreachable("refused")) < 3.0
    with pytest.raises(Unavailable):
        attempts.delay_after(unreachable("refused"))
    for _ in range(20):
        others.delay_after(unreachable("refused"), reached=True)


@pytest.mark.parametrize(
    ("header", "seconds"), [("7", 7.0), ("", None), ("-1", None), ("soon", None), ("²", None), ("9" * 400, None)]
)
def test_retry_after_is_read_from_the_header_where_there_is_no_problem_document(
    header: str, seconds: float | None
) -> None:
    assert read_retry_after(header) == seconds
    with pytest.raises(Overloaded) as caught:
        raise_for_problem(HttpAnswer(429, "http://proxy", {"retry-after": header}, b"slow down"))
    assert caught.value.retry_after == seconds


def test_retry_after_may_be_a_date() -> None:
    later = read_retry_after(email.utils.formatdate(time.time() + 1000, usegmt=True))
    assert later is not None
    assert 900 < later <= 1000
    assert read_retry_after("Wed, 21 Oct 2015 07:28:00 GMT") == 0.0


@every_client
@pytest.mark.parametrize("kind_of_error", [Conflict, NotFound, InvalidInput, Unauthenticated, Internal])
async def test_a_lasting_fault_is_raised_at_once(
    kind: str, kind_of_error: type[PretouchError], script: ScriptedOrchestrator
) -> None:
    script.errors = [kind_of_error("what was wrong", "what to do")]
    async with opened(kind, script.rest_url, script.grpc_address) as client:
        with pytest.raises(kind_of_error, match="what was wrong") as caught:
            await client.session("s1")
    assert type(caught.value) is kind_of_error
    assert caught.value.remedy == "what to do"
    assert len(script.calls) == 1


@every_client
async def test_an_answer_that_is_no_session_is_an_internal_error(kind: str, script: ScriptedOrchestrator) -> None:
    script.errors = [b"<html>router login</html>"]
    async with opened(kind, script.rest_url, script.grpc_address) as client:
        with pytest.raises(Internal, match="answer") as caught:
            await client.session("s1")
    assert "orchestrator" in caught.value.remedy


@every_client
async def test_a_machine_without_an_orchestrator_is_unavailable(kind: str) -> None:
    with socket.socket() as taken:  # bound but not listening: nobody answers here, and nobody else gets the port
        taken.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        async with opened(kind, f"http://{address}", address, timeout=0.5) as client:
            with pytest.raises(Unavailable) as caught:
                await client.session("s1")
    assert caught.value.remedy


@every_client
async def test_a_call_that_nobody_answers_ends_in_time(kind: str) -> None:
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        address = f"127.0.0.1:{silent.getsockname()[1]}"
        async with opened(kind, f"http://{address}", address) as client:
            with pytest.raises((DeadlineExceeded, Unavailable)):
                await client.session("s1", timeout=0.3)


@every_client
async def test_a_broken_event_stream_is_resumed_where_it_broke(kind: str, script: ScriptedOrchestrator) -> None:
    script.connections = [[(1, "session"), (2, "scan")], [(3, "estimate"), (4, "end")]]
    async with opened(kind, script.rest_url, script.grpc_address) as client:
        events = [event async for event in client.events("s1")]
    assert [(event.id, event.type) for event in events] == [(1, "session"), (2, "scan"), (3, "estimate"), (4, "end")]
    assert events[0].data == {"n": 1}
    assert script.resumed == [0, 2]


@every_client
async def test_events_after_the_last_of_an_ended_session_are_none(kind: str, script: ScriptedOrchestrator) -> None:
    script.session = ENDED
    script.connections = [[]]
    async with opened(kind, script.rest_url, script.grpc_address) as client:
        assert [event async for event in client.events("s1", after=7)] == []
    assert script.resumed == [7]


@every_client
async def test_events_of_an_unknown_session_are_refused(kind: str, script: ScriptedOrchestrator) -> None:
    script.errors = [NotFound("no session s9", "look it up")]
    async with opened(kind, script.rest_url, script.grpc_address) as client:
        with pytest.raises(NotFound, match="s9"):
            [event async for event in client.events("s9")]


@every_client
@pytest.mark.parametrize("id", ["", ".", "..", "a/b", "s1/next-scan", "c?d", "a b", "é", "\ud800", "x" * 200])
async def test_an_id_that_is_none_is_not_found(kind: str, id: str, script: ScriptedOrchestrator) -> None:
    async with opened(kind, script.rest_url, script.grpc_address) as client:
        for call in (
            client.session(id),
            client.next_scan(id),
            client.cancel(id),
            client.submit(id, "scan-1", Skipped()),
            client.submit("s1", id, Skipped()),
            anext(client.events(id)),
        ):
            with pytest.raises(NotFound):
                await call
    assert script.calls == []


@pytest.mark.parametrize("kind", ["grpc", "grpc-async"])
async def test_an_ended_session_has_no_next_scan_over_grpc(kind: str, script: ScriptedOrchestrator) -> None:
    async with opened(kind, script.rest_url, script.grpc_address) as client:
        assert (await client.next_scan("s1")).scan_id == "scan-1"
        script.session = ENDED
        with pytest.raises(Conflict, match="exhausted"):
            await client.next_scan("s1")


@every_client
async def test_an_address_that_cannot_be_is_refused(kind: str) -> None:
    with pytest.raises(InvalidInput, match="address"):
        async with opened(kind, "robot:8080", "https://robot"):
            pass


@every_client
async def test_a_certificate_authority_that_cannot_be_read_is_refused(kind: str) -> None:
    with pytest.raises(InvalidInput, match="cannot be used"):
        async with opened(kind, "https://127.0.0.1:1", "127.0.0.1:1", tls_ca="/nowhere/ca.pem"):
            pass
