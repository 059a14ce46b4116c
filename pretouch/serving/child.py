"""One service as a child process, kept running."""

from __future__ import annotations

import asyncio
import json
import sys
import time
from asyncio.subprocess import PIPE, STDOUT, Process
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

import structlog

from pretouch.backoff import Backoff
from pretouch.errors import Unavailable

_FIRST_DELAY, _MAX_DELAY = 0.5, 15.0  # s before a restart
_STABLE = 60.0  # s after which a child that ends counts as a new fault
_KILL_AFTER = 12.0  # s from SIGTERM to SIGKILL: a service's grace and some more
_LINE_LIMIT = 16 * 1024 * 1024  # bytes of a log line

_log = structlog.get_logger("pretouch.up")


class Child:
    """Runs `pretouch serve <name>` on loopback, hands its log lines on, and restarts it on the same port if it ends.

    The child's standard input is a pipe from this process, and it ends when the pipe closes: it cannot outlive this
    process, however this one ends.

    Args:
        port: gRPC port; 0 lets the child choose at its first start.
        environment: all of the child's environment.
        on_line: given each line of the child's log, and its fields if it is a JSON object.
    """

    def __init__(
        self,
        name: str,
        host: str,
        port: int,
        environment: Mapping[str, str],
        on_line: Callable[[bytes, dict[str, Any]], None],
    ) -> None:
        self.name = name
        self._host = host
        self._port = port
        self._environment = environment
        self._on_line = on_line
        self._served = asyncio.Event()
        self._keeping = asyncio.create_task(self._keep())

    async def wait_until_ready(self) -> int:
        """The child's port, once it serves.

        Raises:
            Unavailable: it ended before it ever served.
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
        while True:
            began = time.monotonic()
            how = await self._run()
            if not self._served.is_set():
                raise Unavailable(f"The {self.name} {how} before it was ready.", "Its log above says why.")
            if time.monotonic() - began > _STABLE:
                backoff.reset()
                warned = False
            if not warned:
                _log.warning("a service is restarted", child=self.name, reason=how)
                warned = True
            await asyncio.sleep(backoff.next_delay())

    async def _run(self) -> str:
        """How one run of the child ended."""
        try:
            process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-P", "-m", "pretouch", "serve", self.name, "--until-stdin-closes"),
                *("--host", self._host, "--port", str(self._port)),
                env=self._environment,
                stdin=PIPE,
                stdout=PIPE,
                stderr=STDOUT,
                limit=_LINE_LIMIT,
                start_new_session=True,  # Ctrl-C in a terminal reaches this process alone, which ends them in order
            )
        except OSError as error:
            return f"could not be started ({error})"
        try:
            return await self._follow(process)
        finally:
            if process.returncode is None:
                await self._end(process)

    async def _follow(self, process: Process) -> str:
        """Hands the log on until the process ends."""
        assert process.stdout is not None
        async for line in process.stdout:
            self._read(line)
        return f"ended with exit code {await process.wait()}"

    async def _end(self, process: Process) -> None:
        with suppress(ProcessLookupError):
            if self._served.is_set():
                process.terminate()
            else:  # it has nothing to drain, and may be compiling, which nothing interrupts
                process.kill()
        try:
            async with asyncio.timeout(_KILL_AFTER):
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
            self._served.set()
        self._on_line(line, fields)
