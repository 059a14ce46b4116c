"""The report of a session, over REST alone: the page, a session that is unknown, a service without reports."""

from collections.abc import Iterator

import numpy as np
import pytest
from helpers.client_kinds import opened
from helpers.scripted_orchestrator import ScriptedOrchestrator

from pretouch.errors import Internal, NotFound, Unavailable
from pretouch.estimate import from_prior
from pretouch.prior import Prior
from pretouch.session import Planner, Proposer, Session, State

SESSION = Session("s1", State.CONVERGED, Proposer.RANDOM, Planner.INFORMATION, (), from_prior(Prior(), np.eye(3)))

rest_clients = pytest.mark.parametrize("kind", ["rest", "rest-async"])


@pytest.fixture
def script() -> Iterator[ScriptedOrchestrator]:
    with ScriptedOrchestrator(SESSION) as orchestrator:
        yield orchestrator


@rest_clients
async def test_the_page_comes_as_it_was_sent(kind: str, script: ScriptedOrchestrator) -> None:
    script.errors = [Unavailable("warming up", "wait", 0.0), b"<!doctype html>\xc3\xa9"]
    async with opened(kind, script.rest_url, script.grpc_address) as client:
        assert await client.report("s1") == b"<!doctype html>\xc3\xa9"
    assert script.calls == ["GET /v1/sessions/s1/report"] * 2


@rest_clients
async def test_a_service_without_reports_is_told_from_an_unknown_session(
    kind: str, script: ScriptedOrchestrator
) -> None:
    async with opened(kind, script.rest_url, script.grpc_address) as client:
        script.errors = [NotFound("There is no page.", "Look.")]
        with pytest.raises(Unavailable, match="makes no reports"):
            await client.report("s1")
        script.errors = [NotFound("There is no session.", "Look.")] * 2
        with pytest.raises(NotFound, match="no session"):
            await client.report("s1")


@rest_clients
async def test_what_is_no_page_is_an_internal_error(kind: str, script: ScriptedOrchestrator) -> None:
    async with opened(kind, script.rest_url, script.grpc_address) as client:
        with pytest.raises(Internal, match="not HTML"):
            await client.report("s1")  # the script answers the session's JSON
