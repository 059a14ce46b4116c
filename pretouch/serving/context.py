"""The context that a running service is given."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, TypeVar

import structlog

from pretouch.serving.admission import TokenCheck
from pretouch.serving.held import HeldBytes
from pretouch.serving.metrics import Metrics
from pretouch.serving.settings import Settings
from pretouch.serving.tokens import Tokens
from pretouch.serving.workers import Workers

T = TypeVar("T")


class ServiceContext:
    """A service's settings, tokens, log, metrics and threads.

    `log` is a structlog logger whose lines carry the session and scan of the call they belong to. `draining` is set
    once the service was told to stop: a stream without an end should end then.

    Raises:
        InvalidInput: the file of tokens is wrong.
    """

    def __init__(self, name: str, settings: Settings) -> None:
        self.name = name
        self.settings = settings
        self.log: structlog.typing.FilteringBoundLogger = structlog.get_logger(f"pretouch.{name}")
        self.token_check = TokenCheck(Tokens(settings.token, settings.tokens_file))
        self.metrics = Metrics(name)
        self.held = HeldBytes()
        self.metrics.gauge("held_bytes", "Bytes of requests in memory.").set_function(lambda: self.held.held)
        self.draining = asyncio.Event()
        self._workers = Workers(settings.workers, settings.max_queue)
        self.metrics.gauge("queue_jobs", "CPU jobs that wait for a thread.").set_function(lambda: self._workers.waiting)

    async def run_in_thread(self, fn: Callable[..., T], *args: Any) -> T:
        """`fn(*args)` in one of the service's threads, so that the event loop stays free.

        Raises:
            Overloaded: every thread is busy and the queue is full.
        """
        return await self._workers.run(fn, *args)

    def close(self) -> None:
        """Drops the jobs that wait."""
        self._workers.close()
