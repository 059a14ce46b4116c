"""deploy/mtls: every call between containers, and of robots, is encrypted, and both ends show a certificate."""

from __future__ import annotations

import ssl
from collections.abc import Iterator, Sequence
from pathlib import Path

import httpx
import numpy as np
import pytest
from helpers.deployment import REPOSITORY, SECONDS, TOKEN, Deployment, run
from helpers.scenes import Box, View, World

from pretouch.client import GrpcClient, RestClient
from pretouch.session import SessionRequest, State

pytestmark = pytest.mark.timeout(2400)
FILES = ("-f", "docker-compose.yml", "-f", "deploy/mtls/docker-compose.yml")


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("mtls") / "certificates"
    run(REPOSITORY / "deploy" / "mtls" / "make-certificates", folder)
    return folder


@pytest.fixture(scope="module")
def stack(compose: Sequence[str], certificates: Path) -> Iterator[Deployment]:
    trust = ssl.create_default_context(cafile=certificates / "ca.pem")
    trust.load_cert_chain(certificates / "robot.pem", certificates / "robot.key")
    stack = Deployment((*compose, *FILES), scheme="https", tls=trust, PRETOUCH_CERTIFICATES=str(certificates))
    try:
        stack.do("build", seconds=1800)
        stack.do("up", "-d", seconds=300)
        stack.wait_until_ready()
        yield stack
    finally:
        stack.do("down", "--volumes", "--timeout", "20", seconds=120)


def test_a_robot_with_a_certificate_has_a_session_and_one_without_is_refused(
    stack: Deployment, certificates: Path
) -> None:
    world, view = World((Box.standing((0.08, 0.06, 0.05)),)), View()
    depth, mask = world.depth(view)
    own = {
        "tls_ca": certificates / "ca.pem",
        "tls_cert": certificates / "robot.pem",
        "tls_key": certificates / "robot.key",
    }
    request = SessionRequest(camera=view.camera, base_T_camera=view.base_T_camera, depth_scale=1.0)
    with (
        RestClient(stack.rest, token=TOKEN, timeout=SECONDS, **own) as rest,
        GrpcClient(stack.grpc, token=TOKEN, timeout=SECONDS, **own) as grpc,
    ):
        session = rest.create_session(request, depth.metres, mask.astype(np.uint8))
        assert grpc.session(session.id).state is State.AWAITING_SCAN
    stranger = ssl.create_default_context(cafile=certificates / "ca.pem")
    with pytest.raises(httpx.TransportError):
        httpx.get(f"{stack.rest}/healthz", verify=stranger, timeout=SECONDS, trust_env=False)


@pytest.mark.parametrize("address", ["detector:50051", "registrar:50052", "gateway:50053"])
def test_a_service_answers_only_those_with_a_certificate(stack: Deployment, address: str) -> None:
    shown = "--tls-ca $PRETOUCH_TLS_CLIENT_CA"
    with_own = f"{shown} --tls-cert $PRETOUCH_TLS_CERT --tls-key $PRETOUCH_TLS_KEY"
    for options, answered in (("", False), (shown, False), (with_own, True)):
        said = stack.inside("orchestrator", f"pretouch healthcheck {address} {options}", check=False)
        assert ("SERVING" in said) is answered, (options, said)
