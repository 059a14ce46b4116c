"""Leases: what one process works on, no other does meanwhile. A process that dies loses its leases by time."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import structlog

from pretouch.errors import PretouchError
from pretouch_orchestrator.store.changes import wait_for_change
from pretouch_orchestrator.store.protocol import Store

LIFETIME = 10.0
"""s for which a lease holds without being renewed: how long a step of a process that died holds up the next."""
_RENEWAL = 2.5
POLL = 1.0
"""s after which a waiting process looks again by itself: a lease that runs out is not announced."""


class Leases:
    """The leases of this process, renewed for as long as they are held.

    A lease saves doing work twice. It is not what keeps states consistent: that is the version of each session, which
    also stops a process that was thought dead.
    """

    def __init__(self, store: Store, log: structlog.typing.FilteringBoundLogger) -> None:
        self._store = store
        self._log = log
        self._holders: set[str] = set()
        self._renewing: asyncio.Task[None] | None = None

    @asynccontextmanager
    async def held(self, name: str) -> AsyncIterator[str]:
        """Holds the lease for the block, after waiting for whoever holds it; gives the name of this holder.

        Raises:
            Unavailable: the store cannot be used.
        """
        holder = secrets.token_hex(8)
        while True:
            change = self._store.changes.expect(name)
            if await self._store.acquire_lease(name, holder, LIFETIME):
                break
            await wait_for_change(change, POLL)
        self._holders.add(holder)
        if self._renewing is None:
            self._renewing = asyncio.create_task(self._renew())
        try:
            yield holder
        finally:
            self._holders.discard(holder)
            await asyncio.shield(self._release(name, holder))

    async def close(self) -> None:
        """Stops renewing."""
        if self._renewing is not None:
            self._renewing.cancel()
            await asyncio.gather(self._renewing, return_exceptions=True)

    async def _release(self, name: str, holder: str) -> None:
        try:
            await self._store.release_lease(name, holder)
        except PretouchError as error:
            self._log.warning("a lease was left to run out", problem=error.detail)

    async def _renew(self) -> None:
        try:
            while self._holders:
                await asyncio.sleep(_RENEWAL)
                try:
                    await self._store.renew_leases(list(self._holders), LIFETIME)
                except PretouchError as error:
                    self._log.warning("leases were not renewed", problem=error.detail)
        finally:
            self._renewing = None
