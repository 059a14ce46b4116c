"""Who may come in, and when."""

from __future__ import annotations

import asyncio
import hmac
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from pretouch.errors import Unauthenticated, Unavailable


class Gate:
    """Admits calls while the service serves, to callers with the right token; knows when the last one has left."""

    def __init__(self, token: str | None) -> None:
        self._token = None if token is None else f"Bearer {token}".encode()
        self._closed: str | None = "The service is still warming up."
        self._inside = 0
        self._empty = asyncio.Event()
        self._empty.set()

    def open(self) -> None:
        """From now on calls are let in."""
        self._closed = None

    def close(self) -> None:
        """From now on calls are refused; those inside go on."""
        self._closed = "The service is shutting down."

    @contextmanager
    def admitted(self, authorization: str) -> Iterator[None]:
        """Counts a call as inside for as long as the block lasts.

        Raises:
            Unauthenticated: the authorization is not the bearer token that was set.
            Unavailable: the service does not serve yet, or no more.
        """
        if self._token is not None and not hmac.compare_digest(authorization.encode(), self._token):
            raise Unauthenticated(
                "The call carries a wrong token." if authorization else "The call carries no token.",
                "Send 'authorization: Bearer TOKEN' with the token that the service was started with.",
            )
        if self._closed is not None:
            raise Unavailable(self._closed, "Try again in a few seconds.")
        self._inside += 1
        self._empty.clear()
        try:
            yield
        finally:
            self._inside -= 1
            if self._inside == 0:
                self._empty.set()

    async def emptied(self, seconds: float) -> None:
        """Returns once no call is inside, after `seconds` at the latest."""
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                await self._empty.wait()
