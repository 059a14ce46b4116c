"""Services as processes: started, waited for, stopped, killed.

with FakeUpstream() as upstream, Orchestrator(tmp_path, upstream.address) as orchestrator:
    httpx.get(f"{orchestrator.rest_url}/v1/sessions")
    orchestrator.kill()                    # SIGKILL
    orchestrator.start()                   # again on the same state and the same ports
"""

from __future__ import annotations

import json
import os
import random
import signal
import socket
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any

_TIMEOUT = 60.0  # s: a first start may compile caches on a busy machine


def free_port() -> int:
    """A free port of 127.0.0.1, of those that the system gives nobody who does not ask for them."""
    while True:
        port = random.randrange(10_000, 32_000)
        with suppress(OSError), socket.create_server(("127.0.0.1", port)):
            return port


class Service:
    """`pretouch serve <name>` with the environment's PRETOUCH variables replaced by `variables`."""

    def __init__(self, name: str, port: int, variables: dict[str, str]) -> None:
        self.name = name
        self.port = port
        self.log: list[dict[str, Any]] = []
        self._variables = variables | {"PRETOUCH_PORT": str(port), "GRPC_VERBOSITY": "ERROR"}
        self._process: subprocess.Popen[bytes] | None = None
        self._reader: threading.Thread | None = None
        self._logged = threading.Condition()
        self._ended = True

    @property
    def address(self) -> str:
        """Of gRPC."""
        return f"127.0.0.1:{self.port}"

    def start(self) -> None:
        """Returns once the service says that it is ready."""
        kept = {key: value for key, value in os.environ.items() if not key.startswith("PRETOUCH_")}
        self._process = subprocess.Popen(
            [sys.executable, "-m", "pretouch", "serve", self.name],
            env=kept | self._variables,
            stderr=subprocess.PIPE,
            stdin=subprocess.DEVNULL,
        )
        self.log, self._ended = [], False
        self._reader = threading.Thread(target=self._read, args=(self._process,), daemon=True)
        self._reader.start()
        try:
            self.logged("ready")
        except BaseException:
            self.kill()
            raise

    def logged(self, event: str) -> dict[str, Any]:
        """The log's first line of this event, waited for."""

        def found() -> dict[str, Any] | None:
            return next((line for line in self.log if line.get("event") == event), None)

        with self._logged:
            self._logged.wait_for(lambda: found() is not None or self._ended, _TIMEOUT)
            line = found()
        if line is None:
            raise RuntimeError(f"{self.name} did not log {event!r}: {self.log}")
        return line

    def stop(self) -> int:
        """SIGTERM; the exit code."""
        return self._end(signal.SIGTERM)

    def kill(self) -> int:
        """SIGKILL."""
        return self._end(signal.SIGKILL)

    def peak_memory(self) -> int:
        """Bytes that the process ever held in memory at once."""
        assert self._process is not None
        status = Path(f"/proc/{self._process.pid}/status").read_text()
        return next(int(line.split()[1]) * 1024 for line in status.splitlines() if line.startswith("VmHWM"))

    def _end(self, number: signal.Signals) -> int:
        if self._process is None:
            return 0
        process, self._process = self._process, None
        process.send_signal(number)
        try:
            return process.wait(_TIMEOUT)
        except subprocess.TimeoutExpired:
            process.kill()
            raise
        finally:
            if self._reader is not None:
                self._reader.join(_TIMEOUT)
            if process.stderr is not None:
                process.stderr.close()

    def _read(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stderr is not None
        for raw in process.stderr:
            try:
                line = json.loads(raw)
            except ValueError:
                line = {"event": raw.decode(errors="replace").rstrip()}
            with self._logged:
                self.log.append(line)
                self._logged.notify_all()
        with self._logged:
            self._ended = True
            self._logged.notify_all()


class Orchestrator(Service):
    """A real orchestrator before upstream services at `upstream`, which are one server in tests.

    Args:
        state: directory of its store.
        variables: more of its environment, such as PRETOUCH_TOKEN.
    """

    def __init__(self, state: Path, upstream: str, *, gateway: bool = True, **variables: str) -> None:
        self.state = state
        self.rest_port = free_port()
        own = {"DETECTOR": upstream, "REGISTRAR": upstream, "STATE": str(state), "REST_PORT": str(self.rest_port)}
        if gateway:
            own["GATEWAY"] = upstream
        prefixed = {f"PRETOUCH_ORCHESTRATOR_{key}": value for key, value in own.items()}
        super().__init__("orchestrator", free_port(), prefixed | variables)

    @property
    def rest_url(self) -> str:
        return f"http://127.0.0.1:{self.rest_port}"

    def __enter__(self) -> Orchestrator:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
