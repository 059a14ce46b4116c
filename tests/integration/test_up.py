"""`pretouch up`: all four services start, restart after a crash, and leave no process behind."""

from __future__ import annotations

import json
import os
import re
import select
import signal
import socket
import ssl
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import httpx
import pytest
import trustme
from helpers import box_view

pytestmark = pytest.mark.timeout(600)
READY_WITHIN = 320  # s: a first start compiles the registrar's kernels
TIMEOUT = 60
SERVICES = {"detector", "registrar", "gateway", "orchestrator"}
READY = re.compile(
    r"^pretouch is ready: REST (https?://127\.0\.0\.1:\d+), gRPC (127\.0\.0\.1:\d+), gateway 127\.0\.0\.1:\d+\n$"
)


class Up:
    """A running `pretouch up`; its log goes to a file."""

    def __init__(self, process: subprocess.Popen[str], log: Path) -> None:
        self.process, self.log = process, log

    def first_line(self) -> str:
        """What it says on standard output, once it does."""
        assert self.process.stdout is not None
        readable, _, _ = select.select([self.process.stdout], [], [], READY_WITHIN)
        return self.process.stdout.readline() if readable else ""

    def ready(self) -> tuple[str, str]:
        """REST's URL and gRPC's address, from the ready line."""
        line = self.first_line()
        found = READY.match(line)
        assert found, f"{line!r}: {self.log.read_text()}"
        return found[1], found[2]

    def children(self) -> dict[str, int]:
        """The process id of each service."""
        found = {}
        for folder in Path("/proc").glob("[0-9]*"):
            with suppress(OSError, IndexError, ValueError):
                parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
                words = (folder / "cmdline").read_bytes().decode().split("\0")
                if parent == self.process.pid and "serve" in words:
                    found[words[words.index("serve") + 1]] = int(folder.name)
        return found

    def warnings(self) -> list[dict[str, str]]:
        """The log's lines of its own; what others write there is no JSON of its."""
        lines = [json.loads(line) for line in self.log.read_text().splitlines() if line.startswith("{")]
        return [line for line in lines if line["service"] == "up"]


@contextmanager
def brought_up(folder: Path, *options: str, **environment: str) -> Iterator[Up]:
    kept = {key: value for key, value in os.environ.items() if not key.startswith("PRETOUCH_")}
    with (folder / "up.log").open("w") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "pretouch", "up", "--state", str(folder / "state"), *options],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
            env=kept | environment,
        )
    with process:
        try:
            yield Up(process, folder / "up.log")
        finally:
            if process.poll() is None:
                process.kill()  # the children follow by themselves


def alive(pid: int) -> bool:
    with suppress(OSError):
        stat = Path(f"/proc/{pid}/stat").read_text()
        return "pretouch" in Path(f"/proc/{pid}/cmdline").read_text() and stat.rpartition(")")[2].split()[0] != "Z"
    return False


def eventually(holds: Callable[[], bool]) -> None:
    """Returns once `holds()`: other processes tell nobody."""
    for _ in range(20 * TIMEOUT):
        if holds():
            return
        time.sleep(0.05)
    raise AssertionError("it never came to hold")


def answers(url: str) -> int:
    with suppress(httpx.HTTPError):
        return httpx.get(url, timeout=TIMEOUT).status_code
    return 0


FREE = ("--rest-port", "0", "--grpc-port", "0", "--gateway-port", "0")


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
