"""CPU work off the event loop, in a bounded pool of threads, within a budget of memory."""

from __future__ import annotations

import asyncio
import contextvars
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from typing import Any, TypeVar

from pretouch.cancellation import Cancellation, bind_cancellation
from pretouch.errors import Overloaded
from pretouch.serving.memory import MemoryBudget
from pretouch.tracing import span

T = TypeVar("T")

_FIRST_GUESS, _MEMORY_OF_DURATIONS = 0.3, 0.1
"""s that a job takes, and by which share each job changes that."""
_LONGEST_RETRY = 30.0


class Workers:
    """Runs functions in `workers` threads, in the order of asking; at most `max_queue` more wait.

    A job takes a thread and then its memory. Whoever holds either never waits for the other through this class, so
    that it cannot come to a standstill; a job must not wait for another job.
    """

    def __init__(self, workers: int, max_queue: int, memory: MemoryBudget) -> None:
        self._workers = workers
        self._max_queue = max_queue
        self._memory = memory
        self._pool = ThreadPoolExecutor(workers, thread_name_prefix="pretouch-cpu")
        self._free = asyncio.Semaphore(workers)
        self._duration = _FIRST_GUESS
        self.waiting = 0
        """Jobs that wait for a thread."""

    async def run(self, fn: Callable[..., T], *args: Any, memory: int = 0, begun: bool = False) -> T:
        """`fn(*args)` in a thread, with this task's context variables.

        If the caller is cancelled, a job that waits is never started, and one that runs ends at its next
        `check_cancelled`; until then it keeps its thread and its memory.

        Args:
            memory: bytes that it needs at its peak.
            begun: it is part of something begun earlier, which is not refused half-way.

        Raises:
            Overloaded: every thread is busy and the queue is full, or the system has no memory left.
            TooLarge: the service never has that much memory.
        """
        if not begun and self._free.locked() and self.waiting >= self._max_queue:
            wait = self._duration * (self.waiting + 1) / self._workers
            raise Overloaded(
                f"All {self._workers} workers are busy and {self.waiting} jobs wait.",
                "Try again shortly, or start the service with more workers or another copy of it.",
                min(max(wait, 1.0), _LONGEST_RETRY),
            )
        self.waiting += 1
        try:
            await self._free.acquire()
        finally:
            self.waiting -= 1
        try:
            await self._memory.take(memory)
        except BaseException:
            self._free.release()
            raise
        return await self._run(fn, args, memory)

    async def _run(self, fn: Callable[..., T], args: tuple[Any, ...], memory: int) -> T:
        loop, cancellation, context = asyncio.get_running_loop(), Cancellation(), contextvars.copy_context()
        context.run(bind_cancellation, cancellation)
        began = time.perf_counter()

        def release() -> None:
            self._duration += _MEMORY_OF_DURATIONS * (time.perf_counter() - began - self._duration)
            self._memory.give_back(memory)
            self._free.release()

        def end(_: Future[Any]) -> None:
            with suppress(RuntimeError):  # the loop has ended, and with it the budget
                loop.call_soon_threadsafe(release)

        future = self._pool.submit(context.run, _run_in_span, fn, *args)
        future.add_done_callback(end)
        try:
            return await asyncio.wrap_future(future)
        except asyncio.CancelledError:
            cancellation.cancel()
            raise
        except MemoryError as error:
            raise Overloaded("The service has run out of memory.", "Try again shortly, or ask for less.") from error

    def close(self) -> None:
        """Drops what waits; running jobs end in their own time."""
        self._pool.shutdown(wait=False, cancel_futures=True)


def _run_in_span(fn: Callable[..., T], *args: Any) -> T:
    with span(f"job {getattr(fn, '__qualname__', fn)}"):
        return fn(*args)
