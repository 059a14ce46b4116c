"""Runs blocking calls that may never return, each in its own daemon thread."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any, TypeVar

T = TypeVar("T")


class DaemonThreads:
    """Runs blocking calls for an event loop.

    An executor is not suitable: a call that hangs would occupy one of its few threads, and the interpreter would wait
    for it at exit.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._running: set[asyncio.Future[Any]] = set()

    def start(self, call: Callable[[], T]) -> asyncio.Future[T]:
        """Starts `call`; the future gets what it returns or raises, and must not be cancelled."""
        loop = asyncio.get_running_loop()
        future: asyncio.Future[T] = loop.create_future()
        self._running.add(future)
        future.add_done_callback(self._running.discard)

        def work() -> None:
            try:
                settle = partial(future.set_result, call())
            except BaseException as error:
                settle = partial(future.set_exception, error)
            with suppress(RuntimeError):  # the loop has ended, and nobody waits for the result
                loop.call_soon_threadsafe(settle)

        threading.Thread(target=work, name=self._name, daemon=True).start()
        return future

    async def join(self) -> None:
        """Waits until all calls have ended, including those started meanwhile."""
        while self._running:
            await asyncio.wait(self._running)
