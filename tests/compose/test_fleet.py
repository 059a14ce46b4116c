"""The profile `fleet`: several of each service behind a proxy, and sessions that outlive any one of them."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator, Sequence

import httpx
import numpy as np
import pytest
from helpers.deployment import REPOSITORY, SECONDS, TOKEN, Deployment
from helpers.scenes import Box, View, World

from pretouch.client import GrpcClient, RestClient
from pretouch.session import Session, SessionRequest
from pretouch.tof import Sensor
from pretouch.wire.json import session_to_json

pytestmark = pytest.mark.timeout(2400)
SECRET = REPOSITORY / "deploy" / "fleet" / "secrets" / "postgres_password"
SERVICES = (
    *("detector-1", "detector-2", "registrar-1", "registrar-2", "registrar-3"),
    *("orchestrator-1", "orchestrator-2", "postgres", "proxy"),
)
WORLD, VIEW = World((Box.standing((0.08, 0.06, 0.05)),)), View()


@pytest.fixture(scope="module")
def fleet(compose: Sequence[str]) -> Iterator[Deployment]:
    if not SECRET.exists():
        SECRET.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        SECRET.write_text("0123456789abcdef")
    deployment = Deployment((*compose, "--profile", "fleet"), SERVICES)
    try:
        deployment.do("build", *SERVICES, seconds=1800)
        deployment.do("up", "-d", "proxy", seconds=300)
        deployment.wait_until_ready()
        yield deployment
    finally:
        deployment.do("down", "--volumes", "--timeout", "20", seconds=120)


def opened(client: RestClient | GrpcClient) -> Session:
    depth, mask = WORLD.depth(VIEW)
    request = SessionRequest(camera=VIEW.camera, base_T_camera=VIEW.base_T_camera, depth_scale=1.0)
    return client.create_session(request, depth.metres, mask.astype(np.uint8))


def scanned(client: RestClient | GrpcClient, session: Session) -> Session:
    assert session.next_scan is not None
    samples = WORLD.scanned(session.next_scan.path, Sensor())
    return client.submit(session.id, session.next_scan.scan_id, samples)


@pytest.mark.parametrize("killed", ["orchestrator-1", "registrar-2", "postgres", "proxy"])
def test_a_session_goes_on_when_a_container_is_killed(fleet: Deployment, killed: str) -> None:
    with (
        RestClient(fleet.rest, token=TOKEN, timeout=SECONDS) as rest,
        GrpcClient(fleet.grpc, token=TOKEN, timeout=SECONDS) as grpc,
    ):
        session = scanned(rest, opened(rest))
        os.kill(int(fleet.inspected(killed)["State"]["Pid"]), signal.SIGKILL)
        after = scanned(grpc, session)
        assert [scan.scan_id for scan in after.scans[:-1]] == [scan.scan_id for scan in session.scans]
        assert session_to_json(rest.session(session.id))["scans"] == session_to_json(after)["scans"]
    fleet.wait_until_ready()
    assert fleet.inspected(killed)["RestartCount"] == 1


def test_what_the_proxy_says_itself_is_a_problem_document(fleet: Deployment) -> None:
    for orchestrator in ("orchestrator-1", "orchestrator-2"):
        fleet.do("pause", orchestrator)
    try:
        fleet.wait_until(
            lambda: httpx.get(f"{fleet.rest}/healthz", timeout=SECONDS, trust_env=False).status_code == 503
        )
        answer = httpx.get(f"{fleet.rest}/healthz", timeout=SECONDS, trust_env=False)
        assert answer.headers["content-type"] == "application/problem+json"
        assert answer.headers["retry-after"] == "1"
        assert answer.json()["type"] == "urn:pretouch:problem:unavailable"
    finally:
        for orchestrator in ("orchestrator-1", "orchestrator-2"):
            fleet.do("unpause", orchestrator)
