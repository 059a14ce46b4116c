"""How much memory a service may use, and who may use it now: it is budgeted before it is taken.

Each kind of work estimates from a request's own numbers, such as pixels or samples, what it will need at its peak. The
factors were measured as growth of the resident set, and are half as large again.
"""

from __future__ import annotations

import asyncio
import ctypes
import os
from collections import deque
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path

from pretouch.errors import Overloaded, TooLarge

_LEAST = 64 * 2**20
"""Bytes that work may use at least, however little the service was given."""
_SHARE = 0.5
"""Share of the machine's or container's memory that a service uses unless it is told otherwise."""
_CGROUP_LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")
_M_MMAP_THRESHOLD, _M_ARENA_MAX = -3, -8  # of malloc.h
_LARGE_BLOCK, _ARENAS = 2**20, 2


class MemoryBudget:
    """A number of bytes that is shared in the order of asking.

    Args:
        limit: bytes.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.used = 0
        self._waiting: deque[tuple[int, asyncio.Future[None]]] = deque()

    @asynccontextmanager
    async def reserve(self, size: int, patience: float | None = None) -> AsyncIterator[Reservation]:
        """Holds `size` bytes of the budget for as long as the block lasts, or fewer once that is known.

        Args:
            patience: s that it may wait for its turn; None: for as long as the caller does.

        Raises:
            TooLarge: it is more than there ever is.
            Overloaded: its turn did not come in time.
        """
        await self.take(size, patience)
        reservation = Reservation(self, size)
        try:
            yield reservation
        finally:
            reservation.shrink(0)

    async def take(self, size: int, patience: float | None = None) -> None:
        """Takes `size` bytes, which `give_back` must return; see `reserve`."""
        if size > self.limit:
            raise TooLarge(
                f"The request needs about {size // 2**20} MiB of memory; this service has {self.limit // 2**20} MiB.",
                "Crop the image, thin out the scan or simplify the mesh, or give the service more by PRETOUCH_MEMORY.",
            )
        if size == 0 or (not self._waiting and self.used + size <= self.limit):
            self.used += size
            return
        turn: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        entry = (size, turn)
        self._waiting.append(entry)
        try:
            async with asyncio.timeout(patience):
                await turn
        except BaseException as error:
            if turn.done() and not turn.cancelled():  # its turn came while it gave up
                self.give_back(size)
            elif entry in self._waiting:
                self._waiting.remove(entry)
                self._admit()
            if isinstance(error, TimeoutError):
                raise Overloaded(
                    "The service's memory is in use by other requests.", "Try again shortly.", patience
                ) from error
            raise

    def give_back(self, size: int) -> None:
        """Returns what `take` took."""
        self.used -= size
        self._admit()

    def _admit(self) -> None:
        while self._waiting and self.used + self._waiting[0][0] <= self.limit:
            size, turn = self._waiting.popleft()
            if not turn.cancelled():
                self.used += size
                turn.set_result(None)


class Reservation:
    """Bytes of a budget that are held."""

    def __init__(self, budget: MemoryBudget, size: int) -> None:
        self._budget = budget
        self._size = size

    def shrink(self, size: int) -> None:
        """Gives back what is held above `size` bytes."""
        if size < self._size:
            self._budget.give_back(self._size - size)
            self._size = size


def return_freed_memory() -> None:
    """Has glibc give large blocks back to the system when they are freed, which its own growing threshold prevents."""
    with suppress(OSError, AttributeError):  # another C library
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(_M_MMAP_THRESHOLD, _LARGE_BLOCK)
        mallopt(_M_ARENA_MAX, _ARENAS)


def find_total_memory() -> int:
    """Bytes of the machine, or of the container if that has fewer."""
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    for path in _CGROUP_LIMITS:
        try:
            text = Path(path).read_text().strip()
        except OSError:
            continue
        if text.isdigit():
            total = min(total, int(text))
    return total


def choose_default_memory() -> int:
    """Bytes that a service may use unless it is told otherwise."""
    return int(_SHARE * find_total_memory())


def measure_resident_memory() -> int:
    """Bytes that this process holds at present; 0 where the system does not say."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError):
        return 0


def left_for_work(memory: int) -> int:
    """Bytes of `memory` that work may take besides what the process holds already."""
    return max(_LEAST, memory - measure_resident_memory())
