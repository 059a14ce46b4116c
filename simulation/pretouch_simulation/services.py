"""`pretouch up` as a child of the demo: all four services as the real processes that they are."""

from __future__ import annotations

import os
import re
import select
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Self

from pretouch.errors import DeadlineExceeded, Unavailable
from pretouch.interrupts import interrupts_held_back

_START_TIMEOUT = 320.0
"""s: longer than `pretouch up` itself waits, so that it can say what was missing."""
_END_TIMEOUT = 60.0
_READY = re.compile(rb"REST (\S+), gRPC (\S+), gateway (\S+)")


class Services:
    """All services on free ports of this machine, their state in a temporary directory; use it in a `with` block.

    Args:
        devices: `name=port` of each finger.
        environment: variables for the services beside this process's own.

    Attributes:
        rest: URL of the REST API.
        grpc, gateway: host:port of the orchestrator and of the sensor gateway.
        log: file of what they log.
        pid: process id of `pretouch up`, whose children they are.
    """

    def __init__(self, devices: Sequence[str] = (), environment: Mapping[str, str] | None = None) -> None:
        self._devices = devices
        self._environment = {**os.environ, **(environment or {})}
        self._stack = ExitStack()
        self.rest = self.grpc = self.gateway = ""
        self.log = Path()
        self.pid = 0

    def __enter__(self) -> Self:
        """Starts the services and waits until they are ready.

        Raises:
            Unavailable: they ended; the error says what they logged last.
            DeadlineExceeded: they were not ready in time.
        """
        with self._stack:
            state = Path(self._stack.enter_context(tempfile.TemporaryDirectory(prefix="pretouch-")))
            self.log = log = state / "services.log"
            options = ["--rest-port", "0", "--grpc-port", "0", "--gateway-port", "0", "--state", str(state / "state")]
            options += [part for device in self._devices for part in ("--device", device)]
            errors = self._stack.enter_context(log.open("wb"))
            with interrupts_held_back():
                process = subprocess.Popen(
                    [sys.executable, "-m", "pretouch", "up", "--until-stdin-closes", *options],
                    env=self._environment,
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=errors,
                    start_new_session=True,  # a Ctrl-C is the demo's, which ends them in order
                )
                self._stack.callback(_end, process)
            self.pid = process.pid
            ready = _READY.search(_first_line(process, log))
            if ready is None:
                raise Unavailable(f"The services did not start: {_last_of(log)}", "Mend what they say.")
            self.rest, self.grpc, self.gateway = (part.decode() for part in ready.groups())
            self._stack = self._stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()


def _end(process: subprocess.Popen[bytes]) -> None:
    process.send_signal(signal.SIGTERM)
    try:
        process.wait(_END_TIMEOUT)
    except (subprocess.TimeoutExpired, KeyboardInterrupt):
        process.kill()  # its services end with it
        process.wait()
    for pipe in (process.stdin, process.stdout):
        assert pipe is not None
        pipe.close()


def _first_line(process: subprocess.Popen[bytes], log: Path) -> bytes:
    assert process.stdout is not None
    readable, _, _ = select.select([process.stdout], [], [], _START_TIMEOUT)
    if not readable:
        raise DeadlineExceeded(f"The services did not start in time: {_last_of(log)}", "Try again.")
    return process.stdout.readline()


def _last_of(log: Path) -> str:
    return log.read_bytes()[-600:].decode(errors="replace").strip() or "they said nothing."
