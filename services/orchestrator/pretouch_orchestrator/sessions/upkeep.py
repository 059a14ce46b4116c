"""What keeps the store small: sessions are removed after a time, and earlier where there is no more room."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from dataclasses import dataclass

import structlog

from pretouch.errors import NotFound, PretouchError, Unavailable
from pretouch_orchestrator.sessions.endings import cancel
from pretouch_orchestrator.sessions.events import derive_events
from pretouch_orchestrator.store.protocol import Owned, Snapshot, Stale, Store

_PERIOD = 60.0
_BATCH = 20


@dataclass(frozen=True)
class Limits:
    """What the store may hold.

    Attributes:
        keep: s after its last change for which a session is kept.
        max_bytes: what all sessions together may take.
    """

    keep: float
    max_bytes: int


async def cancel_session(store: Store, owner: str, session_id: str) -> Snapshot:
    """Cancels the session whatever step is under way, unless it has already ended; the session as it was before.

    Raises:
        NotFound: no such session.
    """
    while True:
        before = await store.load_session(owner, session_id)
        if before.session.state.ended:
            return before
        with suppress(Stale):
            after = cancel(before.session)
            await store.end(before, after, derive_events(before.session, after))
            return before


class Upkeep:
    """Removes sessions, one a transaction, so that no step waits for it. Any number of processes may do so at once."""

    def __init__(self, store: Store, limits: Limits, log: structlog.typing.FilteringBoundLogger) -> None:
        self._store = store
        self._limits = limits
        self._log = log

    async def make_room(self) -> None:
        """Removes the sessions that ended longest ago, as long as the store holds more than it may.

        Raises:
            Unavailable: it does, and no session in it has ended.
        """
        while (used := await self._store.used_bytes()) >= self._limits.max_bytes:
            ended = await self._store.find_ended(1, None)
            if not ended:
                raise Unavailable(
                    f"The session store holds {used} bytes, its limit is {self._limits.max_bytes}, and no session in "
                    "it has ended.",
                    "Cancel sessions that are no longer needed, or start the orchestrator with a larger "
                    "PRETOUCH_ORCHESTRATOR_MAX_STORE.",
                    retry_after=30.0,
                )
            await self._remove(ended[0], "to make room")

    async def run(self) -> None:
        """Sweeps for ever."""
        while True:
            try:
                await self.sweep()
            except PretouchError as error:
                self._log.warning("the session store was not swept", problem=error.detail)
            except Exception as error:
                self._log.error("sweeping the session store met a defect", exc_info=error)
            await asyncio.sleep(_PERIOD)

    async def sweep(self) -> None:
        """Removes what is past keeping; sessions that were left without an end are cancelled first."""
        while abandoned := await self._store.find_abandoned(_BATCH, self._limits.keep):
            for each in abandoned:
                with suppress(NotFound):
                    await cancel_session(self._store, *each)
                await self._remove(each, "abandoned")
        while ended := await self._store.find_ended(_BATCH, self._limits.keep):
            for each in ended:
                await self._remove(each, "old")
        await self._store.tidy()
        await self.make_room()

    async def _remove(self, each: Owned, why: str) -> None:
        await self._store.remove(*each)
        self._log.info("session removed", session=each.id, why=why)
