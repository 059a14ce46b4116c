"""The fleet of docker-compose.yml, in real containers. It needs root, to signal what is in them."""

from __future__ import annotations

import json
import os
import secrets
import shutil
import signal
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self

import httpx

from benchmarks.fleet.parts import Fault
from benchmarks.running_service import free_port

_REPOSITORY = Path(__file__).parents[2]
_PARTS = (
    *("proxy", "postgres", "orchestrator-1", "orchestrator-2", "registrar-1", "registrar-2", "registrar-3"),
    *("detector-1", "detector-2"),
)
_READY_WITHIN = 600.0
_RESTARTED_WITHIN = 120.0
_SERVICE_FAULTS = (Fault.KILL, Fault.CRASH, Fault.HANG, Fault.FREEZE, Fault.BLACKHOLE)
_OTHER_FAULTS = (Fault.KILL, Fault.FREEZE, Fault.BLACKHOLE)
_SECRET = _REPOSITORY / "deploy" / "fleet" / "secrets" / "postgres_password"


class ContainerFleet:
    """`docker compose --profile fleet up proxy` on free ports; use it in a `with` block. Images are built if they are
    missing, and volumes are removed at the end.
    """

    def __init__(self) -> None:
        self.parts: Sequence[str] = _PARTS
        self.rest_port, self.grpc_port = free_port(), free_port()
        self.rest, self.grpc = f"http://127.0.0.1:{self.rest_port}", f"127.0.0.1:{self.grpc_port}"
        plugin = subprocess.run(["docker", "compose", "version"], capture_output=True, check=False).returncode == 0
        command = ("docker", "compose") if plugin else (shutil.which("docker-compose") or "docker-compose",)
        self._project = f"pretouch-fleet-{os.getpid()}"
        self._compose = (*command, "--project-name", self._project, "--profile", "fleet")

    def __enter__(self) -> Self:
        if not _SECRET.exists():
            _SECRET.parent.mkdir(mode=0o700, exist_ok=True)
            _SECRET.write_text(secrets.token_hex(24))
        try:
            self._do("up", "-d", "proxy")
            self._wait_until_ready()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._do("down", "--volumes", "--timeout", "20")

    def faults(self, part: str) -> Sequence[Fault]:
        return _OTHER_FAULTS if part in ("proxy", "postgres") else _SERVICE_FAULTS

    def break_part(self, part: str, fault: Fault) -> None:
        container = self._container(part)
        match fault:
            case Fault.KILL:  # docker kill would count as a wish that it stays away
                os.kill(_wait_until_it_runs(container), signal.SIGKILL)
            case Fault.CRASH | Fault.HANG:
                _wait_until_it_runs(container)
                number = signal.SIGKILL if fault is Fault.CRASH else signal.SIGSTOP
                for pid in self._service_pids(container):
                    os.kill(pid, number)
            case Fault.FREEZE:
                _wait_until_it_runs(container)
                _docker("pause", container)
            case _:
                _docker("network", "disconnect", "--force", f"{self._project}_inside", container)

    def mend_part(self, part: str, fault: Fault) -> None:
        container = self._container(part)
        if fault is Fault.FREEZE:
            _docker("unpause", container)
        elif fault is Fault.BLACKHOLE:
            _docker("network", "connect", "--alias", part, f"{self._project}_inside", container)

    def restarts(self) -> dict[str, int]:
        found = {}
        for part in self.parts:
            container = self._container(part)
            logs = subprocess.run(["docker", "logs", container], capture_output=True, check=True)
            by_supervisor = (logs.stdout + logs.stderr).count(b'"a service is restarted"')
            found[part] = by_supervisor + int(_inspect(container)["RestartCount"])
        return found

    def _service_pids(self, container: str) -> list[int]:
        # without -ww, a COLUMNS in the engine's environment would cut the arguments off
        lines = _docker("top", container, "-ww", "-eo", "pid,args").splitlines()[1:]
        return [int(line.split()[0]) for line in lines if "--until-stdin-closes" in line]

    def _container(self, part: str) -> str:
        return self._do("ps", "-q", part).strip()

    def _do(self, *arguments: str) -> str:
        ports = {"PRETOUCH_REST_PORT": str(self.rest_port), "PRETOUCH_GRPC_PORT": str(self.grpc_port)}
        return _run(*self._compose, *arguments, variables=ports)

    def _wait_until_ready(self) -> None:
        end = time.monotonic() + _READY_WITHIN
        while True:
            try:
                if httpx.get(f"{self.rest}/readyz", trust_env=False, timeout=10.0).status_code == 200:
                    return
            except httpx.HTTPError:
                pass
            if time.monotonic() > end:
                raise RuntimeError(f"The fleet is not ready: {self._do('logs', '--tail', '20')}")
            time.sleep(0.5)


def _docker(*arguments: str) -> str:
    return _run("docker", *arguments, variables={})


def _wait_until_it_runs(container: str) -> int:
    """The id of its first process; it may be between two starts."""
    end = time.monotonic() + _RESTARTED_WITHIN
    while time.monotonic() < end:
        state = _inspect(container)["State"]
        if state["Status"] == "running" and int(state["Pid"]) > 0:
            return int(state["Pid"])
        time.sleep(0.2)
    raise RuntimeError(f"{container} does not run: {_docker('logs', '--tail', '20', container)}")


def _inspect(container: str) -> dict[str, Any]:
    description: dict[str, Any] = json.loads(_docker("inspect", container))[0]
    return description


def _run(*command: str, variables: dict[str, str]) -> str:
    done = subprocess.run(
        command, capture_output=True, text=True, env=os.environ | variables, cwd=_REPOSITORY, check=False
    )
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)}: {done.stdout[-2000:]}{done.stderr[-2000:]}")
    return done.stdout
