"""CPU work off the event loop, in a bounded pool of threads."""

from __future__ import annotations

import asyncio
import contextvars
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

from pretouch.errors import Overloaded

T = TypeVar("T")


class Workers:
    """Runs functions in `workers` threads; at most `max_queue` more wait."""

    def __init__(self, workers: int, max_queue: int) -> None:
        self._workers = workers
        self._limit = workers + max_queue
        self._pool = ThreadPoolExecutor(workers, thread_name_prefix="pretouch-cpu")
        self._pending = 0
        self._lock = threading.Lock()

    @property
    def waiting(self) -> int:
        """Jobs that wait for a thread."""
        return max(0, self._pending - self._workers)

    async def run(self, fn: Callable[..., T], *args: Any) -> T:
        """`fn(*args)` in a thread, with this task's context variables.

        A caller that is cancelled takes a waiting job out of the queue; a running one keeps its thread to its end.

        Raises:
            Overloaded: every thread is busy and the queue is full.
        """
        with self._lock:
            if self._pending >= self._limit:
                raise Overloaded(
                    f"All {self._workers} workers are busy and {self._limit - self._workers} jobs wait.",
                    "Try again shortly, or start the service with more workers or another copy of it.",
                )
            self._pending += 1
        future = self._pool.submit(contextvars.copy_context().run, fn, *args)
        future.add_done_callback(self._count_down)
        return await asyncio.wrap_future(future)

    def _count_down(self, _: Future[Any]) -> None:
        with self._lock:
            self._pending -= 1

    def close(self) -> None:
        """Drops what waits; running jobs end in their own time."""
        self._pool.shutdown(wait=False, cancel_futures=True)
