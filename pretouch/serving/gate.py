"""Who may come in, when, and for how long."""

from __future__ import annotations

import asyncio
import hmac
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress

from pretouch.errors import DeadlineExceeded, PretouchError, Unauthenticated, Unavailable


class Gate:
    """Admits calls while the service serves and the token is right, and makes sure that all of them end."""

    def __init__(self, token: str | None) -> None:
        self._token = None if token is None else f"Bearer {token}".encode()
        self._closed: str | None = "The service is still warming up."
        self._inside = 0
        self._empty = asyncio.Event()
        self._empty.set()
        self._bounds: set[asyncio.Timeout] = set()
        self._cut_off = False

    def open(self) -> None:
        """From now on calls are let in."""
        self._closed = None

    def refusal(self, authorization: str) -> PretouchError | None:
        """Why a call with this authorization may not come in now (`Unauthenticated`, `Unavailable`); None if it may."""
        if self._token is not None and not hmac.compare_digest(authorization.encode(), self._token):
            return Unauthenticated(
                "The call carries a wrong token." if authorization else "The call carries no token.",
                "Send 'authorization: Bearer TOKEN' with the token that the service was started with.",
            )
        if self._closed is not None:
            return Unavailable(self._closed, "Try again in a few seconds.")
        return None

    @contextmanager
    def inside(self) -> Iterator[None]:
        """Counts a call as inside for as long as the block lasts."""
        self._inside += 1
        self._empty.clear()
        try:
            yield
        finally:
            self._inside -= 1
            if self._inside == 0:
                self._empty.set()

    @asynccontextmanager
    async def bounded(self, deadline: float | None) -> AsyncIterator[None]:
        """Ends the block after `deadline` seconds, or when the drain's grace is over.

        Raises:
            DeadlineExceeded: the block took longer.
            Unavailable: the service went away meanwhile.
        """
        try:
            async with asyncio.timeout(deadline) as bound:
                self._bounds.add(bound)
                try:
                    yield
                finally:
                    self._bounds.discard(bound)
        except TimeoutError as error:
            if not bound.expired():
                raise
            if self._cut_off:
                raise Unavailable("The service was stopped before the call ended.", "Try again.") from error
            raise DeadlineExceeded(
                f"The call took longer than {deadline:g} s.", "Set a longer deadline on the call, or ask for less."
            ) from error

    async def drain(self, grace: float) -> None:
        """Refuses calls from now on; returns when those inside have left, which they must after `grace` seconds."""
        self._closed = "The service is shutting down."
        with suppress(TimeoutError):
            async with asyncio.timeout(grace):
                await self._empty.wait()
        self._cut_off = True
        now = asyncio.get_running_loop().time()
        for bound in self._bounds:
            bound.reschedule(now)
        with suppress(TimeoutError):
            async with asyncio.timeout(1.0):
                await self._empty.wait()
