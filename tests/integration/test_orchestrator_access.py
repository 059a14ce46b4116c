"""Who may talk to the orchestrator, and how it talks to the others: token, TLS, mutual TLS."""

from __future__ import annotations

import ssl
from pathlib import Path

import grpc
import httpx
import pytest
import trustme
from helpers import box_view
from helpers.fake_upstream import FakeUpstream
from helpers.processes import Orchestrator
from helpers.rest_sessions import assert_problem, opened
from pretouch_orchestrator.settings import OrchestratorSettings

from pretouch.channel import open_sync_channel
from pretouch.errors import InvalidInput
from pretouch.v1 import orchestrator_pb2 as pb
from pretouch.v1.orchestrator_pb2_grpc import OrchestratorServiceStub


def test_a_token_is_asked_for_everywhere_but_at_the_health_pages(tmp_path: Path, upstream: FakeUpstream) -> None:
    with (
        Orchestrator(tmp_path, upstream.address, PRETOUCH_TOKEN="s3cret") as orchestrator,
        httpx.Client(base_url=orchestrator.rest_url, timeout=60) as rest,
    ):
        for path in ("/healthz", "/readyz"):
            assert rest.get(path).status_code == 200
        downloads = ("/v1/sessions/x/report", "/v1/sessions/x/recording.mcap")
        for path in ("/v1/sessions", "/metrics", "/docs", "/openapi.json", *downloads, "/nowhere"):
            refused = rest.get(path)
            assert_problem(refused, 401, "Bearer")
            assert refused.headers["www-authenticate"] == "Bearer"
        wrong = {"Authorization": "Bearer s3cre"}
        assert_problem(rest.post("/v1/sessions", files=box_view.multipart(), headers=wrong), 401, "wrong")
        rest.headers["Authorization"] = "Bearer s3cret"
        session = opened(rest)
        assert upstream.calls[-1].metadata["authorization"] == "Bearer s3cret"
        with open_sync_channel(orchestrator.address) as channel, pytest.raises(grpc.RpcError) as error:
            OrchestratorServiceStub(channel).GetSession(pb.GetSessionRequest(session_id=session["id"]), timeout=10)
        assert error.value.code() is grpc.StatusCode.UNAUTHENTICATED


def test_tls_within_and_without(tmp_path: Path) -> None:
    authority = trustme.CA()
    certificate = authority.issue_cert("127.0.0.1")
    files = {name: tmp_path / f"{name}.pem" for name in ("ca", "cert", "key")}
    authority.cert_pem.write_to_path(files["ca"])
    certificate.cert_chain_pems[0].write_to_path(files["cert"])
    certificate.private_key_pem.write_to_path(files["key"])
    pair = (files["key"].read_bytes(), files["cert"].read_bytes())
    credentials = grpc.ssl_server_credentials([pair], files["ca"].read_bytes(), require_client_auth=True)
    variables = {
        "PRETOUCH_TLS_CERT": str(files["cert"]),
        "PRETOUCH_TLS_KEY": str(files["key"]),
        "PRETOUCH_TLS_CLIENT_CA": str(files["ca"]),
        "PRETOUCH_ORCHESTRATOR_TLS_CA": str(files["ca"]),
    }
    with FakeUpstream(credentials) as upstream, Orchestrator(tmp_path, upstream.address, **variables) as orchestrator:
        url = orchestrator.rest_url.replace("http:", "https:")
        trusting = ssl.create_default_context(cafile=files["ca"])
        with httpx.Client(base_url=url, verify=trusting) as stranger, pytest.raises(httpx.TransportError):
            stranger.get("/healthz")
        with pytest.raises(httpx.TransportError):
            httpx.get(f"{orchestrator.rest_url}/healthz")
        trusting.load_cert_chain(files["cert"], files["key"])
        with httpx.Client(base_url=url, verify=trusting, timeout=60) as rest:
            assert rest.get("/readyz").status_code == 200
            assert opened(rest)["state"] == "awaiting_scan"


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"DETECTOR": ""}, "PRETOUCH_ORCHESTRATOR_DETECTOR"),
        ({"STATE": None}, "PRETOUCH_ORCHESTRATOR_STATE"),
        ({"REST_PORT": "http"}, "REST_PORT"),
        ({"REST_PORT": "65536"}, "REST_PORT"),
    ],
)
def test_a_setting_that_is_missing_or_wrong_is_named(changes: dict[str, str | None], word: str) -> None:
    given = {"DETECTOR": "a:1", "REGISTRAR": "b:2", "STATE": "/tmp"} | changes
    environment = {f"PRETOUCH_ORCHESTRATOR_{key}": value for key, value in given.items() if value is not None}
    with pytest.raises(InvalidInput, match=word):
        OrchestratorSettings.from_environment(environment)


def test_what_another_orchestrator_holds_is_said_in_two_lines(tmp_path: Path, orchestrator: Orchestrator) -> None:
    taken_port = {"PRETOUCH_ORCHESTRATOR_REST_PORT": str(orchestrator.rest_port)}
    for second, words in (
        (Orchestrator(orchestrator.state, "127.0.0.1:1"), "Another orchestrator uses the state directory"),
        (Orchestrator(tmp_path, "127.0.0.1:1", **taken_port), "REST cannot be served"),
    ):
        with pytest.raises(RuntimeError, match=words) as error:
            second.start()
        assert "Traceback" not in str(error.value)
