"""`pretouch up` on the network: TLS and tokens by environment variables and options, and no proxy between services."""

from __future__ import annotations

import ssl
import subprocess
import sys
from pathlib import Path

import httpx
import pytest
import trustme
from helpers import box_view
from helpers.running_up import READY_WITHIN, TIMEOUT, Up

from pretouch.serving.tokens import make_token

pytestmark = pytest.mark.timeout(600)
FREE = ("--rest-port", "0", "--grpc-port", "0", "--gateway-port", "0")
NOWHERE = {name: "http://127.0.0.1:9" for name in ("http_proxy", "https_proxy", "grpc_proxy", "all_proxy")}


def command(folder: Path, *options: str) -> tuple[str, ...]:
    return ("-m", "pretouch", "up", "--state", str(folder / "state"), *FREE, *options)


def test_the_environment_gives_it_tls_and_tokens_and_no_proxy(tmp_path: Path) -> None:
    authority = trustme.CA()
    issued = authority.issue_cert("127.0.0.1")
    files = {name: tmp_path / f"{name}.pem" for name in ("ca", "cert", "key")}
    authority.cert_pem.write_to_path(files["ca"])
    issued.cert_chain_pems[0].write_to_path(files["cert"])
    issued.private_key_pem.write_to_path(files["key"])
    token, entry = make_token("line-1")
    tokens = tmp_path / "tokens.toml"
    tokens.write_text(entry)
    tokens.chmod(0o600)
    variables = {
        "PRETOUCH_HOST": "0.0.0.0",
        "PRETOUCH_TLS_CERT": str(files["cert"]),
        "PRETOUCH_TLS_KEY": str(files["key"]),
        "PRETOUCH_TLS_CLIENT_CA": str(files["ca"]),
        "PRETOUCH_TOKENS_FILE": str(tokens),
    }
    trust = ssl.create_default_context(cafile=files["ca"])
    with Up.running(tmp_path, *command(tmp_path), **variables, **NOWHERE) as up:
        rest, grpc = up.ready()
        assert rest.startswith("https://")
        with httpx.Client(verify=trust, trust_env=False, timeout=TIMEOUT) as stranger:
            for url in (rest, rest.replace("https:", "http:")):
                with pytest.raises(httpx.TransportError):
                    stranger.get(f"{url}/healthz")
        trust.load_cert_chain(files["cert"], files["key"])
        with httpx.Client(base_url=rest, verify=trust, trust_env=False, timeout=TIMEOUT) as friend:
            assert friend.get("/readyz").status_code == 200
            assert friend.get("/v1/sessions").status_code == 401
            friend.headers["Authorization"] = f"Bearer {token}"
            created = friend.post("/v1/sessions", files=box_view.multipart())
            assert created.status_code == 201, created.text
        probe = [sys.executable, "-m", "pretouch", "healthcheck", grpc]
        known = ("--tls-ca", str(files["ca"]), "--tls-cert", str(files["cert"]), "--tls-key", str(files["key"]))
        for options, code in (((), 1), (known, 0)):
            assert subprocess.run([*probe, *options], timeout=TIMEOUT, check=False).returncode == code
        assert "call this service" not in up.log.read_text()
        assert "unencrypted" not in up.log.read_text()
        assert not any(token in Path(f"/proc/{pid}/environ").read_text() for pid in up.children().values())


def test_on_the_network_without_protection_it_warns(tmp_path: Path) -> None:
    with Up.running(tmp_path, *command(tmp_path, "--host", "0.0.0.0")) as up:
        rest, _ = up.ready()
        assert httpx.get(f"{rest}/readyz", timeout=TIMEOUT, trust_env=False).status_code == 200
        log = up.log.read_text()
        for server in ("gRPC", "REST"):
            said = [line for line in log.splitlines() if f'"server": "{server}"' in line]
            assert len(said) == 2, log
            assert any("PRETOUCH_TOKEN" in line for line in said)
            assert any("PRETOUCH_TLS_CERT" in line for line in said)


@pytest.mark.parametrize(
    ("variables", "said"),
    [
        ({"PRETOUCH_TLS_CERT": "cert.pem"}, "not both"),
        ({"PRETOUCH_TLS_CERT": "cert.pem", "PRETOUCH_TLS_KEY": "key.pem"}, "cannot be used"),
        ({"PRETOUCH_TLS_CLIENT_CA": "ca.pem"}, "server has none"),
        ({"PRETOUCH_TOKENS_FILE": "tokens.toml"}, "cannot be read"),
    ],
)
def test_half_a_protection_is_refused(variables: dict[str, str], said: str, tmp_path: Path) -> None:
    with Up.running(tmp_path, *command(tmp_path, "--host", "0.0.0.0"), **variables) as up:
        assert up.process.wait(READY_WITHIN) == 2
        assert said in up.log.read_text()
