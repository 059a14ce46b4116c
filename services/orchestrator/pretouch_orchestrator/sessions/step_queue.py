"""How many steps of sessions are under way at once.

A step is several jobs, here and in the registrar. Were more of them begun than the services can work on, the registrar
would refuse one of a step's later jobs, and its earlier ones would be done again when the robot comes back: with 100
robots on two cores nine of ten steps ended so, and each cost four times its work.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from pretouch.errors import Overloaded

PATIENCE = 10.0
"""s that a step may have to wait for its turn; if it is likely to be longer, it is refused at once."""
_FIRST_GUESS, _MEMORY_OF_DURATIONS = 1.0, 0.1
"""s that a step takes, and by which share each step changes that."""
_LONGEST_RETRY = 30.0


class StepQueue:
    """Lets at most `limit` steps be under way, in the order of asking."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._free = asyncio.Semaphore(limit)
        self._duration = _FIRST_GUESS
        self.waiting = 0
        """Steps that wait for their turn."""

    def check(self) -> None:
        """Raises `Overloaded` if a step that asked now would have to wait for more than PATIENCE."""
        wait = self._duration * (self.waiting + 1) / self._limit
        if self._free.locked() and wait > PATIENCE:
            raise Overloaded(
                f"{self._limit} steps of sessions are under way and {self.waiting} wait.",
                "Try again shortly, or start more orchestrators and registrars.",
                min(wait, _LONGEST_RETRY),
            )

    @asynccontextmanager
    async def turn(self) -> AsyncIterator[None]:
        """Waits for a step's turn, which lasts as long as the block.

        Raises:
            Overloaded: see `check`.
        """
        self.check()
        self.waiting += 1
        try:
            await self._free.acquire()
        finally:
            self.waiting -= 1
        began = time.perf_counter()
        try:
            yield
        finally:
            self._duration += _MEMORY_OF_DURATIONS * (time.perf_counter() - began - self._duration)
            self._free.release()
