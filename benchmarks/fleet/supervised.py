"""One service of a fleet of processes: `pretouch serve NAME --watched`, started again whenever it is gone."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from signal import Signals

import psutil

_AGAIN = 1.0  # s, as Docker waits before it restarts a container


class Supervised:
    """Keeps the service running, as a container's restart policy does; its log goes to a file.

    Args:
        variables: of its environment, which holds no other variable of pretouch.
    """

    def __init__(self, service: str, variables: Mapping[str, str], log: Path) -> None:
        self._service = service
        self._log = log
        kept = {key: value for key, value in os.environ.items() if not key.startswith("PRETOUCH_")}
        self._environment = kept | {"GRPC_VERBOSITY": "ERROR"} | dict(variables)
        self._closing = threading.Event()
        self._process = self._start()
        self._keeper = threading.Thread(target=self._keep, daemon=True)
        self._keeper.start()

    def send(self, number: Signals) -> None:
        """Sends the signal to the supervisor and to what it runs."""
        for process in (self._process.pid, *self._services()):
            with suppress(ProcessLookupError):
                os.kill(process, number)

    def send_to_service(self, number: Signals) -> None:
        """Sends the signal to the service alone."""
        for process in self._services():
            with suppress(ProcessLookupError):
                os.kill(process, number)

    def restarts(self) -> int:
        """How often the supervisors said that they started the service again."""
        return sum(b'"a service is restarted"' in line for line in self._log.read_bytes().splitlines())

    def logged(self, event: str) -> bool:
        """Whether the log has a line of this event."""
        for line in self._log.read_bytes().splitlines():
            with suppress(ValueError):
                if json.loads(line).get("event") == event:
                    return True
        return False

    def close(self) -> None:
        self._closing.set()
        self.send(Signals.SIGCONT)
        self._process.terminate()
        self._keeper.join()

    def _services(self) -> list[int]:
        with suppress(psutil.NoSuchProcess):
            return [child.pid for child in psutil.Process(self._process.pid).children()]
        return []

    def _start(self) -> subprocess.Popen[bytes]:
        with self._log.open("ab") as log:
            return subprocess.Popen(
                [sys.executable, "-P", "-m", "pretouch", "serve", self._service, "--watched"],
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stderr=log,
                start_new_session=True,
            )

    def _keep(self) -> None:
        while True:
            self._process.wait()
            if self._closing.wait(_AGAIN):
                return
            self._process = self._start()
