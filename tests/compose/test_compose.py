"""The containers: hardened, with the documented ports, and able to run a whole session."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from helpers.processes import free_port
from helpers.scenes import Box, View, World
from pretouch_detector.proposals import list_readiness

from pretouch.client import GrpcClient, RestClient, drive
from pretouch.errors import Unauthenticated
from pretouch.geometry import Pose
from pretouch.session import ScanPlan, SessionRequest, State
from pretouch.tof import RangeSamples, Sensor
from pretouch.wire.json import session_to_json

pytestmark = pytest.mark.timeout(2400)  # a first build fetches every package
REPOSITORY = Path(__file__).parents[2]
ENGINE = Path(os.environ.get("PRETOUCH_SHARED", REPOSITORY.parent / "shared")) / "tools" / "docker-engine"
SERVICES = ("detector", "registrar", "gateway", "orchestrator")
TOKEN = "a token for this test"
SECONDS = 60


def run(*command: str | Path, seconds: float = SECONDS, check: bool = True, **environment: str) -> str:
    """Standard output of a command; its standard error goes into the failure."""
    result = subprocess.run(
        [str(word) for word in command],
        capture_output=True,
        text=True,
        timeout=seconds,
        env=os.environ | environment,
        cwd=REPOSITORY,
        check=False,
    )
    assert not check or result.returncode == 0, f"{command}: {result.stdout[-3000:]}{result.stderr[-3000:]}"
    return result.stdout


def succeeds(*command: str) -> bool:
    try:
        return subprocess.run(command, capture_output=True, timeout=SECONDS, check=False).returncode == 0
    except OSError:
        return False


@pytest.fixture(scope="module")
def engine() -> Iterator[None]:
    """A Docker engine: the machine's own, or one that is started for this test and ended after it."""
    there = succeeds("docker", "info")
    if ENGINE.exists() and os.geteuid() == 0:
        run(ENGINE, seconds=1200)
    elif not there:
        pytest.skip(f"no Docker engine runs here, and {ENGINE} is not there or may not start one (needs root)")
    yield
    if not there:
        run(ENGINE, "stop")


@pytest.fixture(scope="module")
def compose(engine: None) -> Sequence[str]:
    """The compose command of this machine."""
    if succeeds("docker", "compose", "version"):
        return ("docker", "compose")
    if shutil.which("docker-compose"):
        return ("docker-compose",)
    pytest.skip("there is neither `docker compose` nor docker-compose")


class Deployment:
    """The running stack under a project name of its own, on free ports."""

    def __init__(self, compose: Sequence[str]) -> None:
        self.rest_port, self.grpc_port = free_port(), free_port()
        self.rest = f"http://127.0.0.1:{self.rest_port}"
        self._compose = (*compose, "--project-name", f"pretouch-test-{os.getpid()}")
        self._variables = {
            "PRETOUCH_TOKEN": TOKEN,
            "PRETOUCH_REST_PORT": str(self.rest_port),
            "PRETOUCH_GRPC_PORT": str(self.grpc_port),
        }

    def do(self, *arguments: str, seconds: float = SECONDS) -> str:
        return run(*self._compose, *arguments, seconds=seconds, **self._variables)

    def container(self, service: str) -> str:
        return self.do("ps", "-q", service).strip()

    def inspected(self, service: str) -> dict[str, Any]:
        description: dict[str, Any] = json.loads(run("docker", "inspect", self.container(service)))[0]
        return description

    def inside(self, service: str, script: str) -> str:
        return run("docker", "exec", self.container(service), "sh", "-c", script)

    def healthy(self) -> bool:
        """The engine asks at intervals, so it may say so later than the services themselves."""
        return all(self.inspected(service)["State"]["Health"]["Status"] == "healthy" for service in SERVICES)

    def service_pid(self, service: str) -> int:
        """The process that serves, as the machine numbers it; 0 while there is none."""
        lines = run("docker", "top", self.container(service), "-eo", "pid,args").splitlines()
        return next((int(line.split()[0]) for line in lines if "--until-stdin-closes" in line), 0)

    def wait_until_ready(self) -> None:
        def ready() -> bool:
            with suppress(httpx.HTTPError):
                return httpx.get(f"{self.rest}/readyz", timeout=SECONDS).status_code == 200 and self.healthy()
            return False

        self.wait_until(ready)

    def wait_until(self, holds: Callable[[], bool]) -> None:
        for _ in range(10 * SECONDS):
            if holds():
                return
            time.sleep(0.1)
        raise AssertionError(self.do("logs", "--tail", "20"))


@pytest.fixture(scope="module")
def stack(compose: Sequence[str]) -> Iterator[Deployment]:
    deployment = Deployment(compose)
    try:
        deployment.do("build", seconds=1800)
        deployment.do("up", "-d", seconds=300)
        deployment.wait_until_ready()
        yield deployment
    finally:
        deployment.do("down", "--volumes", "--timeout", "20", seconds=120)


WORLD = World((Box.standing((0.08, 0.06, 0.05)),))
CORRECTION = Pose.from_rotation_vector((0.02, -0.015, 0.03), (0.009, -0.007, 0.005))
"""Where the object truly is, from where the camera puts it."""


def measured(plan: ScanPlan) -> RangeSamples:
    return WORLD.moved(CORRECTION).scanned(plan.path, Sensor(), np.random.default_rng(7))


def mean_error(base_T_correction: Pose) -> float:
    """m, over the object's visible points."""
    scene = WORLD.scene(View())
    points = scene.base_T_camera.apply(scene.camera.back_project(*_pixels(scene.mask, scene.depth.metres)))
    return float(np.linalg.norm(CORRECTION.apply(points) - base_T_correction.apply(points), axis=1).mean())


def _pixels(mask: Any, metres: Any) -> tuple[Any, Any]:
    v, u = np.nonzero(mask)
    return np.stack([u, v], axis=-1), metres[v, u]


def test_a_session_converges_and_outlives_the_orchestrators_container(stack: Deployment) -> None:
    depth, mask = WORLD.depth(View())
    with RestClient(stack.rest, token=TOKEN, timeout=SECONDS) as client:
        request = SessionRequest(camera=View().camera, base_T_camera=View().base_T_camera, depth_scale=1.0)
        session = client.create_session(request, depth.metres, mask.astype(np.uint8) * 255)
        assert session.state is State.AWAITING_SCAN
        assert session.proposer is list_readiness()[0][0], "the image lacks what the best proposer needs"
        before = mean_error(session.estimate.base_T_correction)
        *_, session = drive(client, session, measured)
        assert session.state in (State.CONVERGED, State.EXHAUSTED)
        assert session.scans
        assert mean_error(session.estimate.base_T_correction) < before / 2
        stack.do("restart", "orchestrator", seconds=120)
        stack.wait_until_ready()
        assert session_to_json(client.session(session.id)) == session_to_json(session)


def test_grpc_is_published_and_both_wires_ask_for_the_token(stack: Deployment) -> None:
    with GrpcClient(f"127.0.0.1:{stack.grpc_port}", token=TOKEN, timeout=SECONDS) as client:
        client.sessions()
    with (
        GrpcClient(f"127.0.0.1:{stack.grpc_port}", token="wrong", timeout=SECONDS) as stranger,
        pytest.raises(Unauthenticated),
    ):
        stranger.sessions()
    assert httpx.get(f"{stack.rest}/v1/sessions", timeout=SECONDS).status_code == 401


def test_only_the_orchestrator_is_published_and_on_this_machine_alone(stack: Deployment) -> None:
    published = {service: stack.inspected(service)["HostConfig"]["PortBindings"] or {} for service in SERVICES}
    assert [service for service in SERVICES if published[service]] == ["orchestrator"]
    bindings = [binding for bound in published["orchestrator"].values() for binding in bound]
    assert {(binding["HostIp"], binding["HostPort"]) for binding in bindings} == {
        ("127.0.0.1", str(stack.rest_port)),
        ("127.0.0.1", str(stack.grpc_port)),
    }


@pytest.mark.parametrize("service", SERVICES)
def test_a_container_runs_without_privileges_on_a_read_only_root(stack: Deployment, service: str) -> None:
    description = stack.inspected(service)
    assert description["HostConfig"]["ReadonlyRootfs"] is True
    assert description["State"]["Health"]["Status"] == "healthy"
    assert stack.inside(service, "id -u; id -g").split() == ["10001", "10001"]
    status = stack.inside(service, "cat /proc/1/status")
    assert re.search(r"^CapEff:\s+0+$", status, re.MULTILINE)
    assert re.search(r"^CapBnd:\s+0+$", status, re.MULTILINE)
    assert re.search(r"^NoNewPrivs:\s+1$", status, re.MULTILINE)
    assert stack.inside(service, "touch /opt/x 2>/dev/null || echo refused; touch /tmp/x && echo kept").split() == [
        "refused",
        "kept",
    ]


@pytest.mark.parametrize("service", SERVICES)
def test_a_container_is_bounded_in_memory_processes_cpu_and_logs(stack: Deployment, service: str) -> None:
    host = stack.inspected(service)["HostConfig"]
    assert 0 < host["Memory"] <= 4 * 2**30
    assert 0 < host["PidsLimit"] <= 512
    assert host["NanoCpus"] > 0
    assert host["LogConfig"]["Config"].keys() == {"max-size", "max-file"}
    assert host["Init"] is True


def test_a_service_that_hangs_in_its_container_is_started_again(stack: Deployment) -> None:
    stopped = stack.service_pid("registrar")
    os.kill(stopped, signal.SIGSTOP)
    stack.wait_until(lambda: stack.service_pid("registrar") not in (stopped, 0))
    stack.wait_until_ready()
    assert stack.inspected("registrar")["RestartCount"] == 0, "its supervisor did it, not the engine"


@pytest.mark.parametrize("service", ["detector", "registrar"])
def test_what_needs_no_network_reaches_none(stack: Deployment, service: str) -> None:
    networks = stack.inspected(service)["NetworkSettings"]["Networks"]
    assert len(networks) == 1
    (name,) = networks
    assert json.loads(run("docker", "network", "inspect", name))[0]["Internal"] is True


@pytest.mark.parametrize("service", SERVICES)
def test_an_image_holds_neither_torch_nor_the_simulation_nor_pip(stack: Deployment, service: str) -> None:
    script = (
        "import importlib.util as u; print([m for m in ('torch', 'plotly', 'matplotlib', 'pip') if u.find_spec(m)])"
    )
    assert stack.inside(service, f'/opt/pretouch/bin/python -c "{script}"').strip() == "[]"


def test_stopping_drains_every_service(stack: Deployment) -> None:
    stack.do("stop", "--timeout", "20", seconds=120)
    assert {service: stack.inspected(service)["State"]["ExitCode"] for service in SERVICES} == dict.fromkeys(
        SERVICES, 0
    )
