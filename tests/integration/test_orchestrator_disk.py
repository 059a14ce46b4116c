"""A disk that is full: every step is refused and changes nothing, `/readyz` says so, and all goes on."""

from __future__ import annotations

import os
import resource
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx
import pytest
from grpc_health.v1 import health_pb2, health_pb2_grpc
from helpers import box_view
from helpers.fake_upstream import FakeUpstream
from helpers.processes import Orchestrator
from helpers.rest_sessions import assert_problem, opened, scan_path, scanned
from pretouch_orchestrator.servicer import SERVICE

from pretouch.channel import open_sync_channel


def limit_files(orchestrator: Orchestrator, size: int) -> None:
    """No file may grow beyond `size` bytes: for the process it is as if the disk were full."""
    assert orchestrator._process is not None
    resource.prlimit(orchestrator._process.pid, resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))


def assert_refused(rest: httpx.Client, session: dict[str, Any], *words: str) -> None:
    """Every call that would write is a 503 that says what to do, and the session is as it was."""
    body = box_view.samples(session["next_scan"])
    path = f"/v1/sessions/{session['id']}"
    for answer in (
        rest.post(scan_path(session), json=body),
        rest.post(f"{scan_path(session)}/samples", json={"from": 0, "samples": body["samples"][:2]}),
        rest.post("/v1/sessions", files=box_view.multipart()),
        rest.delete(path),
        rest.delete(path, params={"purge": "true"}),
        rest.get("/readyz"),
    ):
        assert_problem(answer, 503, *words)
        assert "Retry-After" in answer.headers
    assert rest.get(path).json() == session
    assert rest.get("/healthz").status_code == 200


def assert_well(rest: httpx.Client, session: dict[str, Any]) -> None:
    assert rest.get("/readyz").status_code == 200
    assert len(scanned(rest, session)["scans"]) == len(session["scans"]) + 1
    assert rest.delete(f"/v1/sessions/{session['id']}", params={"purge": "true"}).status_code == 204
    assert opened(rest)["state"] == "awaiting_scan"


def test_steps_on_a_full_disk_are_refused_and_counted_once_there_is_room(
    rest: httpx.Client, orchestrator: Orchestrator
) -> None:
    session = scanned(rest, opened(rest))
    limit_files(orchestrator, 1)
    try:
        assert_refused(rest, session, "session store", "disk")
        wait_for_health(orchestrator, health_pb2.HealthCheckResponse.NOT_SERVING)
    finally:
        limit_files(orchestrator, resource.RLIM_INFINITY)
    assert_well(rest, session)
    wait_for_health(orchestrator, health_pb2.HealthCheckResponse.SERVING)


def wait_for_health(orchestrator: Orchestrator, status: int) -> None:
    """Returns once the health service says this of the sessions; of the process it says SERVING all the time."""
    with open_sync_channel(orchestrator.address) as channel:
        stub = health_pb2_grpc.HealthStub(channel)
        serves = stub.Check(health_pb2.HealthCheckRequest(), timeout=30).status
        assert serves == health_pb2.HealthCheckResponse.SERVING
        for seen in stub.Watch(health_pb2.HealthCheckRequest(service=SERVICE), timeout=60):
            if seen.status == status:
                return


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 64 MB of its own."""
    place = tmp_path / "disk"
    place.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64m", "tmpfs", str(place)], capture_output=True)
    if mounted.returncode:
        pytest.skip("This user may not mount a file system.")
    yield place
    subprocess.run(["umount", "--lazy", str(place)], check=True)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may mount a file system")
def test_readiness_tells_of_a_disk_before_it_is_full(small_disk: Path, fakes: FakeUpstream) -> None:
    with (
        Orchestrator(small_disk / "state", fakes.address) as orchestrator,
        httpx.Client(base_url=orchestrator.rest_url, timeout=60) as rest,
    ):
        session = scanned(rest, opened(rest))
        assert rest.get("/readyz").status_code == 200
        ballast = small_disk / "ballast"
        ballast.write_bytes(bytes(40 << 20))
        assert_problem(rest.get("/readyz"), 503, "MiB left")
        session = scanned(rest, session)  # there is room for a step still
        assert len(session["scans"]) == 2
        with suppress(OSError):
            ballast.write_bytes(bytes(64 << 20))
        assert_refused_sooner_or_later(rest)
        ballast.unlink()
        assert rest.get(f"/v1/sessions/{session['id']}").json() == session
        assert_well(rest, session)


def assert_refused_sooner_or_later(rest: httpx.Client) -> None:
    """Sessions are opened in what the log's file still holds, until one is refused."""
    for _ in range(100):
        answer = rest.post("/v1/sessions", files=box_view.multipart())
        if answer.status_code != 201:
            return assert_problem(answer, 503, "session store", "disk")
    raise AssertionError("100 sessions were stored on a full disk")
