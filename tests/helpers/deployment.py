"""docker-compose.yml as a real deployment."""

from __future__ import annotations

import json
import os
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx

from helpers.processes import free_port

REPOSITORY = Path(__file__).parents[2]
SERVICES = ("detector", "registrar", "gateway", "orchestrator")
TOKEN = "a-token-for-this-test"
SECONDS = 60


def run(
    *command: str | Path, seconds: float = SECONDS, check: bool = True, variables: Mapping[str, str] | None = None
) -> str:
    """Standard output of a command; its standard error goes into the failure."""
    result = subprocess.run(
        [str(word) for word in command],
        capture_output=True,
        text=True,
        timeout=seconds,
        env={**os.environ, **(variables or {})},
        cwd=REPOSITORY,
        check=False,
    )
    assert not check or result.returncode == 0, f"{command}: {result.stdout[-3000:]}{result.stderr[-3000:]}"
    return result.stdout


class Deployment:
    """The running stack under a project name of its own, on free ports.

    Args:
        compose: the compose command of this machine, with its global options.
        services: that must be healthy.
        scheme: of REST.
        tls: httpx's `verify`.
    """

    def __init__(
        self,
        compose: Sequence[str],
        services: Sequence[str] = SERVICES,
        scheme: str = "http",
        tls: Any = True,
        **variables: str,
    ) -> None:
        self.rest_port, self.grpc_port = free_port(), free_port()
        self.rest = f"{scheme}://127.0.0.1:{self.rest_port}"
        self.grpc = f"127.0.0.1:{self.grpc_port}"
        self._services = services
        self._tls = tls
        self.project = f"pretouch-test-{os.getpid()}"
        self._compose = (*compose, "--project-name", self.project)
        self._variables = variables | {
            "PRETOUCH_TOKEN": TOKEN,
            "PRETOUCH_REST_PORT": str(self.rest_port),
            "PRETOUCH_GRPC_PORT": str(self.grpc_port),
        }

    def do(self, *arguments: str, seconds: float = SECONDS) -> str:
        return run(*self._compose, *arguments, seconds=seconds, variables=self._variables)

    def container(self, service: str) -> str:
        return self.do("ps", "-q", service).strip()

    def inspected(self, service: str) -> dict[str, Any]:
        description: dict[str, Any] = json.loads(run("docker", "inspect", self.container(service)))[0]
        return description

    def inside(self, service: str, script: str, check: bool = True) -> str:
        return run("docker", "exec", self.container(service), "sh", "-c", script, check=check)

    def service_pid(self, service: str) -> int | None:
        """The process that serves, as the machine numbers it; None while there is none: 0 would be one's own group."""
        # without -ww, a COLUMNS in the engine's environment would cut the arguments off
        lines = run("docker", "top", self.container(service), "-ww", "-eo", "pid,args").splitlines()
        return next((int(line.split()[0]) for line in lines if "--until-stdin-closes" in line), None)

    def healthy(self) -> bool:
        """The engine asks at intervals, so it may say so later than the services themselves."""
        return all(self.inspected(service)["State"]["Health"]["Status"] == "healthy" for service in self._services)

    def wait_until_ready(self) -> None:
        def ready() -> bool:
            with suppress(httpx.HTTPError):
                answer = httpx.get(f"{self.rest}/readyz", timeout=SECONDS, verify=self._tls, trust_env=False)
                return answer.status_code == 200 and self.healthy()
            return False

        self.wait_until(ready)

    def wait_until(self, holds: Callable[[], bool]) -> None:
        for _ in range(10 * SECONDS):
            if holds():
                return
            time.sleep(0.1)
        raise AssertionError(self.do("logs", "--tail", "20"))
