"""Admission control: which calls are accepted, how long they may take, and how they are drained."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from typing import Any

from pretouch.errors import DeadlineExceeded, Overloaded, TooManyTries, Unauthenticated, Unavailable
from pretouch.serving.caller import Caller
from pretouch.serving.tokens import Tokens
from pretouch.serving.tries import WrongTries

MAX_CALLS = 1024
"""gRPC calls under way at once, streams included."""


class TokenCheck:
    """Tells by what a call or request carries as `authorization` who makes it, and how to refuse nobody's."""

    def __init__(self, tokens: Tokens) -> None:
        self._tokens = tokens
        self._wrong_tries = WrongTries()

    @property
    def required(self) -> bool:
        """Whether a token is asked for."""
        return self._tokens.required

    def identify(self, authorization: bytes) -> Caller | None:
        """Who calls with this authorization, b"" for none; None if it is not accepted."""
        return self._tokens.identify(authorization)

    def refuse(self, authorization: bytes, address: str) -> Unauthenticated:
        """The error for a call from `address` that `identify` did not accept."""
        if authorization and (wait := self._wrong_tries.spend(address)) > 0:
            return TooManyTries(
                "Too many wrong tokens came from this address.", "Send the right one, which is always taken.", wait
            )
        return Unauthenticated(
            f"The call carries {'a wrong' if authorization else 'no'} token.",
            "Send `authorization: Bearer TOKEN` with a token that the service knows.",
        )


class AdmissionControl:
    """Accepts calls while the service serves, as many as it can hold, and ends those under way when it drains."""

    def __init__(self) -> None:
        self._closed: str | None = "The service is still warming up."
        self._admitted: set[asyncio.Task[Any]] = set()
        self._under_way = 0
        self._empty = asyncio.Event()
        self._empty.set()
        self._bounds: set[asyncio.Timeout] = set()
        self._cut_off = False

    def open(self) -> None:
        """Accepts calls from now on."""
        self._closed = None

    @property
    def closed(self) -> Unavailable | None:
        """The error for every call while the service warms up or shuts down; None while it serves."""
        return None if self._closed is None else Unavailable(self._closed, "Try again in a few seconds.")

    def admit(self, task: asyncio.Task[Any]) -> Unavailable | Overloaded | None:
        """None if the call that `task` serves may be read, and counts until the task ends; else the error for it."""
        if (closed := self.closed) is not None:
            return closed
        if len(self._admitted) >= MAX_CALLS:
            return Overloaded(f"{MAX_CALLS} calls are under way.", "Try again shortly.")
        self._admitted.add(task)
        task.add_done_callback(self._admitted.discard)
        return None

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
