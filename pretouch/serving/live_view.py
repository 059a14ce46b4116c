"""`pretouch session view` beside the services of `pretouch up`, as a process of its own."""

from __future__ import annotations

import asyncio
import sys
from asyncio.subprocess import PIPE
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from importlib.util import find_spec

import structlog

from pretouch.backoff import Backoff
from pretouch.errors import InvalidInput, Unavailable
from pretouch.serving.settings import Settings

_FIRST_DELAY, _MAX_DELAY = 0.5, 15.0  # s before a restart
_KILL_AFTER = 5.0  # s from the end of its standard input

_log = structlog.get_logger("pretouch.up")


@dataclass(frozen=True)
class LiveView:
    """What is shown to viewers, on the loopback interface.

    Attributes:
        foxglove_port: of Foxglove's WebSocket; None: it is not served.
        rerun: whether Rerun's data and its viewer for browsers are served.
    """

    foxglove_port: int | None = None
    rerun: bool = False

    def __bool__(self) -> bool:
        return self.foxglove_port is not None or self.rerun

    def check(self, settings: Settings) -> None:
        """
        Raises:
            Unavailable: what it needs is not installed.
            InvalidInput: it cannot call an orchestrator with these settings.
        """
        packages = {"foxglove": self.foxglove_port is not None, "rerun": self.rerun}
        for package, needed in packages.items():
            if needed and find_spec(package) is None:
                raise Unavailable(
                    f"--{package} needs the package {package}-sdk, which is not installed.",
                    "Run: pip install 'pretouch[live]'",
                )
        if settings.tls_cert is not None:
            raise InvalidInput(
                "The live view would have to trust this orchestrator's certificate, and be given one where it asks.",
                "Start it apart: pretouch session view --foxglove --url https://NAME:8080 --tls-ca FILE.",
            )
        if settings.tokens_file is not None and settings.token is None:
            raise InvalidInput(
                "The live view needs to know whose sessions it shows.",
                "Start it apart, with a token of theirs: pretouch session view --foxglove --token TOKEN.",
            )

    @asynccontextmanager
    async def running(self, url: str, environment: Mapping[str, str]) -> AsyncIterator[None]:
        """Shows the orchestrator at `url` while the block lasts; it is started again if it ends."""
        keeping = asyncio.create_task(self._keep(url, environment))
        try:
            yield
        finally:
            keeping.cancel()
            with suppress(asyncio.CancelledError):
                await keeping

    async def _keep(self, url: str, environment: Mapping[str, str]) -> None:
        options = ["--url", url, "--until-stdin-closes"]
        if self.foxglove_port is not None:
            options += ["--foxglove", "--foxglove-port", str(self.foxglove_port)]
        if self.rerun:
            options += ["--rerun"]
        backoff = Backoff(_FIRST_DELAY, _MAX_DELAY)
        while True:
            process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-P", "-m", "pretouch", "session", "view", *options),
                env=environment,
                stdin=PIPE,  # it ends when this closes, so it cannot outlive this process
                stdout=sys.stderr.fileno(),
                start_new_session=True,
            )
            try:
                code = await process.wait()
            finally:
                if process.returncode is None:
                    await _end(process)
            _log.warning("the live view is restarted", reason=f"ended with exit code {code}")
            await asyncio.sleep(backoff.next_delay())


NOTHING_SHOWN = LiveView()


async def _end(process: asyncio.subprocess.Process) -> None:
    assert process.stdin is not None
    process.stdin.close()
    try:
        async with asyncio.timeout(_KILL_AFTER):
            await process.wait()
    except TimeoutError:
        with suppress(ProcessLookupError):
            process.kill()
        await process.wait()
