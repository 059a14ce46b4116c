"""A service as a process of its own: its logs and its signals."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

from pretouch.serving.logs import configure_logs
from pretouch.serving.memory import return_freed_memory
from pretouch.serving.open_files import raise_open_file_limit
from pretouch.serving.server import Running, started
from pretouch.serving.settings import Settings
from pretouch.serving.tracing import recording_spans


def call_when_stdin_closes(stop: Callable[[], None]) -> None:
    """Calls `stop` in the running loop once standard input, a pipe from the parent process, closes."""
    loop, stdin = asyncio.get_running_loop(), sys.stdin.fileno()

    def on_stdin() -> None:
        if not os.read(stdin, 4096):
            loop.remove_reader(stdin)
            stop()

    loop.add_reader(stdin, on_stdin)


@asynccontextmanager
async def ended_by_signals(*, until_stdin_closes: bool = False) -> AsyncIterator[None]:
    """Ends the block at the first SIGTERM or SIGINT; later ones are ignored.

    `until_stdin_closes` ends it too when standard input does, so that it cannot outlive who started this process.
    """
    task = asyncio.current_task()
    assert task is not None
    stopping = False

    def stop() -> None:
        nonlocal stopping
        if not stopping:
            stopping = True
            task.cancel()

    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop)
    if until_stdin_closes:
        call_when_stdin_closes(stop)
    try:
        yield
    except asyncio.CancelledError:
        if not stopping:
            raise
        task.uncancel()


async def serve(name: str, running: Running, settings: Settings, *, until_stdin_closes: bool = False) -> None:
    """Serves `running` until SIGTERM or SIGINT, and drains; a second signal ends it at once.

    Logs one line with the event `ready` and the bound ports. `until_stdin_closes` ends it too when standard input
    does, so that it cannot outlive the process that holds the other end.

    Raises:
        InvalidInput: TLS material that cannot be used.
        Unavailable: a port cannot be bound.
    """
    configure_logs(name, settings.log_level)
    raise_open_file_limit()
    return_freed_memory()
    task = asyncio.current_task()
    assert task is not None
    warm = False
    stopping = asyncio.Event()

    def stop() -> None:
        if stopping.is_set() or not warm:
            task.cancel()
        stopping.set()

    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop)
    if until_stdin_closes:
        call_when_stdin_closes(stop)
    try:
        with recording_spans(name):
            async with started(name, running, settings) as service:
                warm = True
                service.context.log.info(
                    "ready", host=settings.host, port=service.port, metrics_port=service.metrics_port, pid=os.getpid()
                )
                await stopping.wait()
                service.context.log.info("stopping")
    except asyncio.CancelledError:
        if not stopping.is_set():
            raise
        task.uncancel()
    # gRPC's own tasks end a moment after its server, and complain where asyncio cancels them first
    if rest := asyncio.all_tasks() - {task}:
        await asyncio.wait(rest, timeout=1.0)
