"""`pretouch up`: all four services start, restart after a crash, and leave no process behind."""

from __future__ import annotations

import os
import signal
import socket
import ssl
import subprocess
import sys
from contextlib import AbstractContextManager
from pathlib import Path

import httpx
import pytest
import trustme
from helpers import box_view
from helpers.running_up import READY_WITHIN, TIMEOUT, Up, alive, answers, eventually

pytestmark = pytest.mark.timeout(600)
SERVICES = {"detector", "registrar", "gateway", "orchestrator"}
FREE = ("--rest-port", "0", "--grpc-port", "0", "--gateway-port", "0")


def brought_up(folder: Path, *options: str, **environment: str) -> AbstractContextManager[Up]:
    return Up.running(folder, "-m", "pretouch", "up", "--state", str(folder / "state"), *options, **environment)


def test_all_four_come_up_and_back_and_leave_nothing_behind(tmp_path: Path) -> None:
    with brought_up(tmp_path, *FREE) as up:
        rest, grpc = up.ready()
        assert answers(f"{rest}/readyz") == 200
        probe = [sys.executable, "-m", "pretouch", "healthcheck", grpc]
        assert subprocess.run(probe, timeout=TIMEOUT, check=False, capture_output=True).returncode == 0
        first = up.children()
        assert first.keys() == SERVICES
        assert up.warnings() == []

        for service in ("detector", "orchestrator"):
            os.kill(first[service], signal.SIGKILL)
            eventually(lambda service=service: up.children().get(service, first[service]) != first[service])
        eventually(lambda: answers(f"{rest}/readyz") == 200)
        session = httpx.post(f"{rest}/v1/sessions", files=box_view.multipart(), timeout=TIMEOUT)
        assert session.status_code == 201, session.text
        restarts = [line["child"] for line in up.warnings() if line["event"] == "a service is restarted"]
        assert restarts == ["detector", "orchestrator"]

        last = up.children()
        up.process.send_signal(signal.SIGTERM)
        assert up.process.wait(TIMEOUT) == 0
        assert not any(alive(pid) for pid in (*first.values(), *last.values()))
        assert answers(f"{rest}/healthz") == 0


def test_a_signal_during_the_start_ends_it_cleanly(tmp_path: Path) -> None:
    with brought_up(tmp_path, *FREE) as up:
        eventually(lambda: len(up.children()) >= 3)
        started = up.children()
        up.process.send_signal(signal.SIGINT)
        assert up.process.wait(TIMEOUT) == 0
        assert not any(alive(pid) for pid in started.values())
        assert up.first_line() == ""


def test_it_ends_with_whoever_holds_its_standard_input_if_told_so(tmp_path: Path) -> None:
    with brought_up(tmp_path, *FREE, "--until-stdin-closes") as up:
        eventually(lambda: len(up.children()) >= 3)
        started = up.children()
        assert up.process.stdin is not None
        up.process.stdin.close()
        assert up.process.wait(TIMEOUT) == 0
        assert not any(alive(pid) for pid in started.values())


def test_nothing_outlives_it_even_if_it_is_killed(tmp_path: Path) -> None:
    for_one_service = {"PRETOUCH_METRICS_PORT": "1", "PRETOUCH_PORT": "1"}
    authority = trustme.CA()
    server = authority.issue_cert("127.0.0.1")
    server.cert_chain_pems[0].write_to_path(tmp_path / "cert.pem")
    server.private_key_pem.write_to_path(tmp_path / "key.pem")
    authority.cert_pem.write_to_path(tmp_path / "ca.pem")
    config = tmp_path / "up.toml"
    config.write_text(f'token = "s3cret"\ntls-cert = "{tmp_path}/cert.pem"\ntls-key = "{tmp_path}/key.pem"\n')
    with brought_up(tmp_path, *FREE, "--config", str(config), **for_one_service) as up:
        rest, grpc = up.ready()
        trust = ssl.create_default_context(cafile=tmp_path / "ca.pem")
        assert httpx.get(f"{rest}/v1/sessions", verify=trust).status_code == 401
        headers = {"authorization": "Bearer s3cret"}
        assert httpx.get(f"{rest}/v1/sessions", verify=trust, headers=headers).status_code == 200
        assert httpx.get(f"{rest}/readyz", verify=trust).status_code == 200
        probe = [sys.executable, "-m", "pretouch", "healthcheck", grpc, "--tls-ca", str(tmp_path / "ca.pem")]
        assert subprocess.run(probe, timeout=TIMEOUT, check=False, capture_output=True).returncode == 0
        children = up.children()
        assert not any("s3cret" in Path(f"/proc/{pid}/cmdline").read_text() for pid in children.values())
        up.process.kill()
        up.process.wait(TIMEOUT)
        eventually(lambda: not any(alive(pid) for pid in children.values()))


@pytest.mark.parametrize("option", ["--grpc-port", "--rest-port", "--gateway-port"])
def test_a_taken_port_ends_it_with_a_reason(tmp_path: Path, option: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        with brought_up(tmp_path, *FREE, option, port) as up:
            assert up.process.wait(READY_WITHIN) == 1
            log = up.log.read_text()
            assert f"127.0.0.1:{port}" in log
            assert f"The {'gateway' if 'gateway' in option else 'orchestrator'} ended" in log
            assert "Traceback" not in log
            assert up.children() == {}


def test_an_address_of_no_machine_and_a_name_used_twice_are_wrong_usage(tmp_path: Path) -> None:
    for wrong, said in (
        (("--device", "a=/dev/x", "--device", "a=/dev/y"), "same name"),
        (("--host", "999.1.2.3"), "no address of this machine"),
    ):
        with brought_up(tmp_path, *FREE, *wrong) as up:
            assert up.process.wait(READY_WITHIN) == 2
            assert said in up.log.read_text()


def test_a_device_that_is_none_ends_it_with_a_reason(tmp_path: Path) -> None:
    with brought_up(tmp_path, *FREE, "--device", "finger=nonsense://here") as up:
        assert up.process.wait(READY_WITHIN) == 1
        assert "nonsense" in up.log.read_text()
