"""The context that a running service is given."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any, TypeVar

import structlog

from pretouch.serving.admission import TokenCheck
from pretouch.serving.memory import MemoryBudget, left_for_work
from pretouch.serving.metrics import Metrics
from pretouch.serving.settings import Settings
from pretouch.serving.tokens import Tokens
from pretouch.serving.workers import Workers

T = TypeVar("T")


_SHARE_OF_MESSAGES, _SHARE_OF_SHORT = 0.25, 0.1
"""Shares of the memory for requests while they are read and wait: for those that may hold images, and for others, which
do not wait behind them. The rest is for work, so that a request that waits for it cannot keep others from ending."""
_BRIEF_QUEUE = 8
"""How many times as many brief jobs may wait as others."""


class ServiceContext:
    """A service's settings, tokens, log, metrics, threads and memory.

    `log` is a structlog logger whose lines carry the session and scan of the call they belong to. `draining` is set
    once the service was told to stop: a stream without an end should end then. A service may set `readiness`, which
    raises a `PretouchError` while it cannot serve: the health service then says so under the service's name.

    Raises:
        InvalidInput: the file of tokens is wrong.
    """

    def __init__(self, name: str, settings: Settings) -> None:
        self.name = name
        self.settings = settings
        self.log: structlog.typing.FilteringBoundLogger = structlog.get_logger(f"pretouch.{name}")
        self.token_check = TokenCheck(Tokens(settings.token, settings.tokens_file))
        self.metrics = Metrics(name)
        self.draining = asyncio.Event()
        self.readiness: Callable[[], Awaitable[None]] | None = None
        self.messages, self.short_messages, self._work = MemoryBudget(0), MemoryBudget(0), MemoryBudget(0)
        self._set_aside = 0
        self.share_memory()
        self._workers = Workers(settings.workers, settings.max_queue, self._work)
        self._brief = Workers(1, _BRIEF_QUEUE * settings.max_queue, self._work)
        self.metrics.gauge("queue_jobs", "CPU jobs that wait for a thread.").set_function(lambda: self._workers.waiting)
        for name, budget in (("message", self.messages), ("work", self._work)):
            gauge = self.metrics.gauge(f"{name}_memory_bytes", f"Memory reserved for {name}s.")
            gauge.set_function(partial(getattr, budget, "used"))

    @property
    def memory(self) -> int:
        """Bytes that requests may use at once, besides what the service itself holds."""
        return self.messages.limit + self.short_messages.limit + self._work.limit

    def share_memory(self) -> None:
        """Divides what the process does not hold yet; called once more when the service is warm."""
        left = left_for_work(self.settings.memory - self._set_aside)
        self.messages.limit = int(_SHARE_OF_MESSAGES * left)
        self.short_messages.limit = int(_SHARE_OF_SHORT * left)
        self._work.limit = left - self.messages.limit - self.short_messages.limit

    def set_aside(self, size: int) -> None:
        """Keeps `size` bytes from requests, for what the service will come to hold."""
        self._set_aside += size

    async def run_in_thread(self, fn: Callable[..., T], *args: Any, memory: int = 0) -> T:
        """`fn(*args)` in one of the service's threads, so that the event loop stays free; see `Workers.run`.

        Args:
            memory: bytes that it needs at its peak.

        Raises:
            Overloaded: every thread is busy and the queue is full.
            TooLarge: the service never has that much memory.
        """
        return await self._workers.run(fn, *args, memory=memory)

    async def go_on_in_thread(self, fn: Callable[..., T], *args: Any, memory: int = 0) -> T:
        """As `run_in_thread`, for a part of something begun earlier: it waits however many others do."""
        return await self._workers.run(fn, *args, memory=memory, begun=True)

    async def run_briefly(self, fn: Callable[..., T], *args: Any) -> T:
        """As `run_in_thread`, for what takes milliseconds: it does not wait behind long jobs."""
        return await self._brief.run(fn, *args)

    def close(self) -> None:
        """Drops the jobs that wait."""
        self._workers.close()
        self._brief.close()
