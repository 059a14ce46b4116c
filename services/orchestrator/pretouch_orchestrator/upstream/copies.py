"""The copies of an upstream service: each call goes to the copy that it belongs to, or to the next that lives."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import AsyncGenerator, AsyncIterator, Callable
from contextlib import aclosing, asynccontextmanager, suppress
from typing import Any

import structlog

from pretouch.backoff import Backoff
from pretouch.errors import DeadlineExceeded, Overloaded, PretouchError, Unavailable
from pretouch_orchestrator.upstream.addresses import Addresses
from pretouch_orchestrator.upstream.connection import RefusesToken, Unreachable, UpstreamConnection
from pretouch_orchestrator.upstream.ring import rank_copies

PATIENCE = 5.0
"""s: how long calls are retried while their service is unavailable or busy; enough for it to restart."""
_FIRST_DELAY, _MAX_DELAY, _JITTER = 0.05, 1.0, 0.5
_FIRST_LOOK, _LAST_LOOK = 0.2, 5.0
"""s between two looks at whether a copy that did not answer lives again."""
_RESOLVE_EVERY = 5.0
"""s after which a DNS name is resolved again."""

_log = structlog.get_logger()


class Copies:
    """All copies of one service. One that cannot be reached is left out until it answers a health check.

    Args:
        name: what errors call the service.
        connect: opens the connection to the copy at an address.
    """

    def __init__(self, name: str, addresses: Addresses, connect: Callable[[str], UpstreamConnection]) -> None:
        self.name = name
        self._addresses = addresses
        self._connect = connect
        self._connections: dict[str, UpstreamConnection] = {}
        self._absent: dict[str, asyncio.Task[None]] = {}
        self._turn = itertools.count()

    @property
    def absent(self) -> frozenset[str]:
        """Addresses of the copies that are left out at present."""
        return frozenset(self._absent)

    @asynccontextmanager
    async def opened(self) -> AsyncIterator[None]:
        """Keeps the list of copies up to date for as long as the block lasts."""
        for address in self._addresses.listed:
            self._connections[address] = self._connect(address)
        following = asyncio.create_task(self._follow_name()) if not self._addresses.listed else None
        try:
            yield
        finally:
            for task in (*self._absent.values(), *([following] if following else [])):
                task.cancel()
            await asyncio.gather(*(connection.close() for connection in self._connections.values()))

    async def call(self, method: str, request: Any, deadline: float, key: bytes | None = None) -> Any:
        """The response of a unary method, within `deadline` seconds over all copies and retries.

        Args:
            key: what the call is about: its home is asked first. None: the copies take turns.

        Raises:
            Unavailable: no copy is available for PATIENCE seconds.
            Overloaded: the copy is busy for as long.
            DeadlineExceeded: a copy accepted the call but did not respond in time.
            PretouchError: the service's own error.
        """
        now = asyncio.get_running_loop().time
        started, backoff = now(), Backoff(_FIRST_DELAY, _MAX_DELAY, _JITTER)
        turn = b"" if key is not None else str(next(self._turn)).encode()
        tried: set[str] = set()
        failure: PretouchError
        while True:
            copy = self._choose(key or turn, tried)
            try:
                if copy is None:
                    raise self._explain_absence()
                left = started + deadline - now()
                if left <= 0:
                    raise DeadlineExceeded(
                        f"The {self.name} did not answer within {deadline:g} s.",
                        "Repeat the request: nothing was changed. Check that service's load.",
                    )
                return await copy.call(method, request, left)
            except RefusesToken:
                raise
            except (Unavailable, Overloaded) as error:
                failure = error
            if copy is not None and isinstance(failure, Unavailable):
                tried.add(copy.address)
                if isinstance(failure, Unreachable):
                    self._leave_out(copy.address)
                if self._choose(key or turn, tried) is not None:
                    continue
            delay = backoff.next_delay()
            if isinstance(failure, Overloaded) and failure.retry_after is not None:
                delay = max(delay, failure.retry_after)
            if now() + delay > started + min(PATIENCE, deadline):
                raise failure
            await asyncio.sleep(delay)
            tried.clear()

    async def stream(self, method: str, request: Any) -> AsyncGenerator[Any]:
        """The responses of a streaming method of one copy, which is not called again.

        Raises:
            Unavailable: no copy is available.
            PretouchError: the service's own error.
        """
        copy = self._choose(str(next(self._turn)).encode(), set())
        if copy is None:
            raise self._explain_absence()
        async with aclosing(copy.stream(method, request)) as responses:
            async for response in responses:
                yield response

    async def check(self) -> None:
        """Raises `Unavailable` unless at least one copy reports that it serves."""
        if not self._connections:
            raise self._explain_absence()
        checks = [asyncio.ensure_future(copy.check()) for copy in self._connections.values()]
        try:
            for check in asyncio.as_completed(checks):
                try:
                    return await check
                except Unavailable as error:
                    failure = error
            raise failure
        finally:
            for check in checks:
                check.cancel()
            await asyncio.gather(*checks, return_exceptions=True)

    def _choose(self, key: bytes, tried: set[str]) -> UpstreamConnection | None:
        """The copy to ask next: of those that are not known to be absent, or of all if all are."""
        present = self._connections.keys() - self._absent.keys() or self._connections.keys()
        left = rank_copies(present - tried, key)
        return self._connections[left[0]] if left else None

    def _leave_out(self, address: str) -> None:
        if address not in self._absent and address in self._connections:
            _log.warning("a copy cannot be reached", service=self.name, address=address)
            self._absent[address] = asyncio.create_task(self._await_return(address))

    async def _await_return(self, address: str) -> None:
        backoff = Backoff(_FIRST_LOOK, _LAST_LOOK, _JITTER)
        while address in self._connections:
            await asyncio.sleep(backoff.next_delay())
            with suppress(Unavailable, KeyError):
                await self._connections[address].check()
                _log.info("a copy is back", service=self.name, address=address)
                break
        del self._absent[address]

    async def _follow_name(self) -> None:
        """Keeps the connections those to what the name resolves to."""
        while True:
            with suppress(Unavailable):
                found = await self._addresses.resolve()
                for address in [each for each in self._connections if each not in found]:
                    await self._connections.pop(address).close()
                for address in found:
                    if address not in self._connections:
                        self._connections[address] = self._connect(address)
            await asyncio.sleep(_RESOLVE_EVERY)

    def _explain_absence(self) -> Unavailable:
        return Unavailable(
            f"No {self.name} can be reached.", "Start one or wait, then repeat the request: nothing was changed."
        )
