"""Recordings in Rerun: its server of data and its viewer for browsers, in a process of its own."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from asyncio.subprocess import DEVNULL, Process
from contextlib import suppress
from importlib.util import find_spec
from typing import Any, Self

from pretouch.backoff import Backoff
from pretouch.errors import Unavailable
from pretouch.live.blueprint import make_blueprint
from pretouch.live.feed import Update
from pretouch.recording.writer import write_messages

_HOST = "127.0.0.1"
_MEMORY = "512MiB"
"""For data that late viewers get; beyond it the oldest is dropped."""
_READY_WITHIN = 30.0


class RerunServer:
    """Serves within an `async with` block, on the loopback interface alone; each session is a recording of its own.

    Attributes:
        url: of the viewer for browsers.

    Raises:
        Unavailable: on entering, it does not start.
    """

    def __init__(self, port: int, web_port: int) -> None:
        self._port, self._web_port = port, web_port
        self._data = f"rerun+http://{_HOST}:{port}/proxy"
        self.url = f"http://{_HOST}:{web_port}/?url=rerun%2Bhttp%3A%2F%2F{_HOST}%3A{port}%2Fproxy"
        self._process: Process | None = None
        self._session = ""
        self._stream: Any = None

    async def __aenter__(self) -> Self:
        options = ("--serve-web", "--bind", _HOST, "--port", str(self._port), "--web-viewer-port", str(self._web_port))
        self._process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-P", "-m", "rerun_cli", *options, "--server-memory-limit", _MEMORY),
            stdin=DEVNULL,
            stdout=DEVNULL,
            start_new_session=True,
        )
        try:
            async with asyncio.timeout(_READY_WITHIN):
                await self._wait_until_ready(self._process)
        except BaseException as error:
            await self.__aexit__()
            if isinstance(error, TimeoutError):
                raise Unavailable("Rerun's server did not start in time.", "Try `rerun --serve-web`.") from error
            raise
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._process is not None and self._process.returncode is None:
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGTERM)  # it has a child of its own
            await self._process.wait()

    def show(self, update: Update | None) -> None:
        """Sends what is new."""
        if update is None:
            return
        import rerun

        if update.session_id != self._session:
            self._session = update.session_id
            self._stream = rerun.RecordingStream("pretouch", recording_id=update.session_id)
            self._stream.connect_grpc(self._data, default_blueprint=make_blueprint())
        self._stream.log_file_from_contents(f"session-{update.session_id}.mcap", write_messages(update.new))
        self._stream.flush()

    async def _wait_until_ready(self, process: Process) -> None:
        backoff = Backoff(0.05, 0.5)
        while True:
            if process.returncode is not None:
                raise Unavailable(
                    f"Rerun's server ended with exit code {process.returncode}.",
                    f"Its words above say why; ports {self._port} and {self._web_port} must be free.",
                )
            with suppress(OSError):
                for port in (self._port, self._web_port):
                    _, writer = await asyncio.open_connection(_HOST, port)
                    writer.close()
                return
            await asyncio.sleep(backoff.next_delay())


def check_installed() -> None:
    """Raises `ModuleNotFoundError` where Rerun is not installed."""
    if find_spec("rerun") is None:
        raise ModuleNotFoundError("No module named 'rerun'", name="rerun")
