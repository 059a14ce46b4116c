"""One service that restarts when it hangs: what a container runs, since Docker restarts only what has ended."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from pretouch.serving.child import Child, serve_command
from pretouch.serving.logs import configure_logs
from pretouch.serving.process import ended_by_signals
from pretouch.serving.settings import Settings


async def serve_watched(name: str, settings: Settings, environment: Mapping[str, str], alive_file: Path | None) -> None:
    """Serves `name` in a child process until SIGTERM or SIGINT; the child's log is this process's.

    Args:
        environment: all of the child's, with the settings.
        alive_file: touched whenever the service answered that it serves, so that a container's health check costs
            next to nothing.

    Raises:
        Unavailable: the service ended before it was ever ready.
    """
    configure_logs(name, settings.log_level)

    def note_alive() -> None:
        if alive_file is not None:
            with suppress(OSError):  # the file then gets old, and says enough
                alive_file.touch()

    command = serve_command(name)
    child = Child(name, command, settings.port, environment, _forward, on_serving=note_alive, grace=settings.grace)
    try:
        async with ended_by_signals():
            await child.wait_until_ready()
            await asyncio.Event().wait()
    finally:
        await child.stop()


def _forward(line: bytes, _: dict[str, Any]) -> None:
    with suppress(OSError):  # nobody may read our log any more; the service goes on
        sys.stderr.buffer.write(line)
        sys.stderr.buffer.flush()
