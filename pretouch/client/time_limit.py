"""The limit of one call's time, over everything that it does: asyncio has one, `BoundedTransport` keeps the other."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from contextvars import ContextVar

from pretouch.errors import DeadlineExceeded

_end: ContextVar[float | None] = ContextVar("pretouch_call_end", default=None)


@asynccontextmanager
async def within_async(seconds: float) -> AsyncIterator[None]:
    """Raises `DeadlineExceeded` where the block takes longer."""
    limit = asyncio.timeout(seconds)
    try:
        async with limit:
            yield
    except TimeoutError as error:
        if not limit.expired():
            raise
        raise too_late(seconds) from error


@contextmanager
def within(seconds: float) -> Iterator[None]:
    """As `within_async`, for what `BoundedTransport` does in the block."""
    token = _end.set(time.monotonic() + seconds)
    try:
        yield
    finally:
        _end.reset(token)


def shorten(timeout: float | None) -> float:
    """`timeout` s of one operation, or what the call has left if that is less.

    Raises:
        TimeoutError: it has nothing left.
    """
    end = _end.get()
    seconds = float("inf") if timeout is None else timeout
    if end is not None:
        seconds = min(seconds, end - time.monotonic())
    if seconds <= 0:
        raise TimeoutError("The call's time is over.")
    return seconds


def too_late(seconds: float) -> DeadlineExceeded:
    """The error of a call that took longer than `seconds`."""
    return DeadlineExceeded(
        f"No complete answer came within {seconds:.3g} s.",
        "Try again, or allow a longer timeout; check that the orchestrator runs at this address.",
    )
