"""The containers: hardened, with the documented ports, and able to run a whole session."""

from __future__ import annotations

import json
import os
import re
import signal
from collections.abc import Iterator, Sequence
from typing import Any

import httpx
import numpy as np
import pytest
from helpers.deployment import SECONDS, SERVICES, TOKEN, Deployment, run
from helpers.scenes import Box, View, World
from pretouch_detector.proposals import list_readiness

from pretouch.client import GrpcClient, RestClient, drive
from pretouch.errors import Unauthenticated
from pretouch.geometry import Pose
from pretouch.session import ScanPlan, SessionRequest, State
from pretouch.tof import RangeSamples, Sensor
from pretouch.wire.json import session_to_json

pytestmark = pytest.mark.timeout(2400)  # a first build fetches every package


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
    stack.wait_until(lambda: stack.service_pid("registrar") is not None)
    stopped = stack.service_pid("registrar")
    assert stopped is not None
    os.kill(stopped, signal.SIGSTOP)
    stack.wait_until(lambda: stack.service_pid("registrar") not in (stopped, None))
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
    script = "import importlib.util as u; print([m for m in ('torch', 'matplotlib', 'pip') if u.find_spec(m)])"
    assert stack.inside(service, f'/opt/pretouch/bin/python -c "{script}"').strip() == "[]"


def test_stopping_drains_every_service(stack: Deployment) -> None:
    stack.do("stop", "--timeout", "20", seconds=120)
    assert {service: stack.inspected(service)["State"]["ExitCode"] for service in SERVICES} == dict.fromkeys(
        SERVICES, 0
    )
