"""One service as a child process, kept running."""

from __future__ import annotations

import asyncio
import json
import sys
import time
from asyncio.subprocess import PIPE, STDOUT, Process
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import structlog

from pretouch.backoff import Backoff
from pretouch.errors import Unavailable
from pretouch.serving.probing import PATIENT, Probing, wait_until_hung

READY_WITHIN = 300.0
"""s from a child's start until it serves; a first start may compile the registrar's kernels."""
_FIRST_DELAY, _MAX_DELAY = 0.5, 15.0  # s before a restart
_STABLE = 60.0  # s after which a child that ends counts as a new fault
_KILL_AFTER = 7.0  # s beyond the grace, from SIGTERM to SIGKILL
_LINE_LIMIT = 16 * 1024 * 1024  # bytes of a log line

_log = structlog.get_logger("pretouch.up")


def serve_command(*options: str) -> tuple[str, ...]:
    """The command that serves with these options of `pretouch serve`, in this process's Python."""
    return (sys.executable, "-P", "-m", "pretouch", "serve", *options)


class Child:
    """Runs a service, hands its log lines on, and restarts it on the same port if it ends or hangs.

    It hangs if it leaves several health checks in a row unanswered, or does not get ready. A hung process cannot drain,
    so it is killed. The checks come over a Unix socket, which no TLS, proxy or choice of host can cut off.

    The child's standard input is a pipe from this process, and it ends when the pipe closes: it cannot outlive this
    process, however this one ends.

    Args:
        name: for the log.
        command: starts the service; see `serve_command`. Its port, and what this class needs, is added.
        port: gRPC port; 0 lets the child choose at its first start.
        environment: all of the child's environment.
        on_line: given each line of the child's log, and its fields if it is a JSON object.
        on_serving: called whenever the child answered a health check and serves.
        grace: s that the child gives running calls when it is told to stop.
    """

    def __init__(
        self,
        name: str,
        command: Sequence[str],
        port: int,
        environment: Mapping[str, str],
        on_line: Callable[[bytes, dict[str, Any]], None],
        *,
        on_serving: Callable[[], None] = lambda: None,
        grace: float = 5.0,
        probing: Probing = PATIENT,
    ) -> None:
        self.name = name
        self._command = command
        self._port = port
        self._environment = environment
        self._on_line = on_line
        self._on_serving = on_serving
        self._kill_after = grace + _KILL_AFTER
        self._probing = probing
        self._served = asyncio.Event()
        self._ready = asyncio.Event()  # of the present run
        self._keeping = asyncio.create_task(self._keep())

    async def wait_until_ready(self) -> int:
        """The child's port, once it serves.

        Raises:
            Unavailable: it ended, or hung, before it ever served.
        """
        served = asyncio.create_task(self._served.wait())
        try:
            await asyncio.wait((served, self._keeping), return_when=asyncio.FIRST_COMPLETED)
        finally:
            served.cancel()
        if self._keeping.done():
            self._keeping.result()
        return self._port

    async def stop(self) -> None:
        """Ends the child, by force if it does not drain in time; returns when it is gone."""
        self._keeping.cancel()
        with suppress(asyncio.CancelledError, Unavailable):
            await self._keeping

    async def _keep(self) -> None:
        backoff, warned = Backoff(_FIRST_DELAY, _MAX_DELAY), False
        with TemporaryDirectory(prefix="pretouch-") as folder:  # mode 0700: only this user reaches the socket
            while True:
                began = time.monotonic()
                how = await self._run(Path(folder) / "health.sock")
                if not self._served.is_set():
                    raise Unavailable(f"The {self.name} {how} before it was ready.", "Its log above says why.")
                if time.monotonic() - began > _STABLE:
                    backoff.reset()
                    warned = False
                if not warned:
                    _log.warning("a service is restarted", child=self.name, reason=how)
                    warned = True
                await asyncio.sleep(backoff.next_delay())

    async def _run(self, socket: Path) -> str:
        """How one run of the child ended."""
        self._ready.clear()
        try:
            process = await asyncio.create_subprocess_exec(
                *(*self._command, "--port", str(self._port), "--until-stdin-closes", "--health-socket", str(socket)),
                env=self._environment,
                stdin=PIPE,
                stdout=PIPE,
                stderr=STDOUT,
                limit=_LINE_LIMIT,
                start_new_session=True,  # Ctrl-C in a terminal reaches this process alone, which ends them in order
            )
        except OSError as error:
            return f"could not be started ({error})"
        killing = asyncio.create_task(self._kill_when_hung(process, socket))
        try:
            ended = await self._follow(process)
            return killing.result() if killing.done() else ended
        finally:
            killing.cancel()
            if process.returncode is None:
                await self._end(process)

    async def _kill_when_hung(self, process: Process, socket: Path) -> str:
        """Kills the process once it hangs; how it did."""
        try:
            async with asyncio.timeout(READY_WITHIN):
                await self._ready.wait()
            how = await wait_until_hung(socket, self._probing, self._on_serving)
        except TimeoutError:
            how = f"did not get ready within {READY_WITHIN:g} s"
        with suppress(ProcessLookupError):
            process.kill()
        return how

    async def _follow(self, process: Process) -> str:
        """Hands the log on until the process ends."""
        assert process.stdout is not None
        async for line in process.stdout:
            self._read(line)
        return f"ended with exit code {await process.wait()}"

    async def _end(self, process: Process) -> None:
        with suppress(ProcessLookupError):
            if self._ready.is_set():
                process.terminate()
            else:  # it has nothing to drain, and may be compiling, which nothing interrupts
                process.kill()
        try:
            async with asyncio.timeout(self._kill_after):
                await self._follow(process)
        except TimeoutError:
            with suppress(ProcessLookupError):
                process.kill()
            await process.wait()

    def _read(self, line: bytes) -> None:
        fields: Any = None
        with suppress(ValueError):
            fields = json.loads(line)
        if not isinstance(fields, dict):
            fields = {}
        if fields.get("event") == "ready" and "port" in fields:
            self._port = int(fields["port"])
            self._ready.set()
            self._served.set()
        self._on_line(line, fields)
