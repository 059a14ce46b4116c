"""Admission control: which calls are accepted, how long they may take, and how they are drained."""

from __future__ import annotations

import asyncio
import hmac
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress

from pretouch.errors import DeadlineExceeded, PretouchError, Unauthenticated, Unavailable


class TokenCheck:
    """Compares what a call or request carries as `authorization` with the service's token, in constant time."""

    def __init__(self, token: str | None) -> None:
        self._expected = None if token is None else f"Bearer {token}".encode()

    def refusal(self, authorization: bytes) -> Unauthenticated | None:
        """The error for a caller with this authorization, b"" for none; None if it is accepted."""
        if self._expected is None or hmac.compare_digest(authorization, self._expected):
            return None
        return Unauthenticated(
            f"The call carries {'a wrong' if authorization else 'no'} token.",
            "Send `authorization: Bearer TOKEN` with the token that the service was started with.",
        )


class AdmissionControl:
    """Accepts calls that carry the token while the service serves, and ends those under way when it drains."""

    def __init__(self, token: str | None) -> None:
        self._token_check = TokenCheck(token)
        self._closed: str | None = "The service is still warming up."
        self._under_way = 0
        self._empty = asyncio.Event()
        self._empty.set()
        self._bounds: set[asyncio.Timeout] = set()
        self._cut_off = False

    def open(self) -> None:
        """Accepts calls from now on."""
        self._closed = None

    def refusal(self, authorization: str) -> PretouchError | None:
        """The error (`Unauthenticated`, `Unavailable`) for a call with this authorization; None if it is accepted."""
        if (refusal := self._token_check.refusal(authorization.encode())) is not None:
            return refusal
        return None if self._closed is None else Unavailable(self._closed, "Try again in a few seconds.")

    @contextmanager
    def track_call(self) -> Iterator[None]:
        """Counts a call as under way for as long as the block lasts."""
        self._under_way += 1
        self._empty.clear()
        try:
            yield
        finally:
            self._under_way -= 1
            if self._under_way == 0:
                self._empty.set()

    @asynccontextmanager
    async def limit_duration(self, deadline: float | None) -> AsyncIterator[None]:
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
        """Refuses calls from now on and waits for those under way, which are ended after `grace` seconds."""
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
