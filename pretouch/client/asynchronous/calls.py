"""What every client does for a call: build it, send it, try again, decode the answer; subclasses add how it is sent."""

# ruff: noqa: ASYNC109 -- a call's timeout covers its retries, which a timeout around the call could not tell apart

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Generic, Self

from pretouch.client.api import AnswerT, Call, MessageT, ResultT
from pretouch.client.arguments import check_timeout, failing_as
from pretouch.client.retries import Attempts
from pretouch.errors import Conflict, Internal, InvalidInput, PretouchError

REPORT = "Report it, with the error that it came from."


class AsyncCalls(ABC, Generic[MessageT, AnswerT]):
    """Calls of one service; `async with` closes it.

    Args:
        timeout: s for a whole call, retries included.
    """

    def __init__(self, timeout: float) -> None:
        self._timeout = check_timeout(timeout)
        self._reached = False
        self._closed = False

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Closes the connections; calls under way and later ones raise `Conflict`."""
        self._closed = True

    async def _run(self, build: Callable[[], Call[MessageT, AnswerT, ResultT]], timeout: float | None) -> ResultT:
        attempts = Attempts(self._timeout if timeout is None else check_timeout(timeout))
        with failing_as(InvalidInput, "The call's arguments cannot be sent", "See the method's description."):
            call = build()
        while True:
            try:
                self._check_open()
                with failing_as(Internal, "The call failed", REPORT):
                    answer = await self._send(call.message, attempts.remaining())
                    self._reached = True
                    return call.parse(answer)
            except PretouchError as error:
                self._check_open(error)
                await asyncio.sleep(attempts.delay_after(error, self._reached))

    def _check_open(self, error: PretouchError | None = None) -> None:
        if self._closed:
            raise Conflict("The client is closed.", "Open another one.") from error

    @abstractmethod
    async def _send(self, message: MessageT, seconds: float) -> AnswerT:
        """Sends one message and returns its answer within `seconds`."""
