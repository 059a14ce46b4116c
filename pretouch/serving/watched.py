"""One service that restarts when it hangs: what a container runs, since Docker restarts only what has ended."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from pretouch.serving.child import Child, serve_command
from pretouch.serving.logs import configure_logs
from pretouch.serving.process import ended_by_signals
from pretouch.serving.settings import Settings


async def serve_watched(name: str, settings: Settings, environment: Mapping[str, str]) -> None:
    """Serves `name` in a child process until SIGTERM or SIGINT; the child's log is this process's.

    Args:
        environment: all of the child's, with the settings.

    Raises:
        Unavailable: the service ended before it was ever ready.
    """
    configure_logs(name, settings.log_level)
    child = Child(name, serve_command(name), settings.port, environment, _forward, grace=settings.grace)
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
