"""The events of sessions, and how they reach the clients that follow one."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from dataclasses import asdict

from pretouch.errors import NotFound, Unavailable
from pretouch.session import Session
from pretouch.wire.json import estimate_to_json, session_to_json
from pretouch_orchestrator.store.changes import wait_for_change
from pretouch_orchestrator.store.protocol import Event, NewEvent, Store

_PAUSE = 2.0
"""s after which a stream tries again to read from a store that could not be used."""


def derive_events(before: Session | None, after: Session) -> list[NewEvent]:
    """The events of one step, derived from the session before and after it; `before` is None at its creation."""
    whole = NewEvent("session", session_to_json(after))
    estimate = NewEvent("estimate", estimate_to_json(after.estimate, after.base_T_object))
    if before is None:
        events = [whole, estimate]
    else:
        events = [NewEvent("scan", asdict(scan)) for scan in after.scans[len(before.scans) :]]
        events += [estimate] * (after.estimate is not before.estimate)
        events.append(whole)
    if after.state.ended:
        reason = {} if after.reason is None else {"reason": after.reason}
        events.append(NewEvent("end", {"state": after.state.value} | reason))
    return events


class Broker:
    """Follows sessions, whichever process steps them: followers read the events from the store, so that none is lost or
    repeated.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._closed = False

    def close(self) -> None:
        """Ends all streams because the service stops."""
        self._closed = True
        self._store.changes.announce_all()

    async def follow(
        self, owner: str, session_id: str, after: int, heartbeat: float | None
    ) -> AsyncGenerator[Event | None]:
        """The session's events after the id `after`, past ones first, until its `end`; None after each `heartbeat`
        seconds of silence. They also end where the session is removed, and wait where the store cannot be used.

        Raises:
            NotFound: no such session.
        """
        session, _, newest = await self._store.load_session(owner, session_id)
        ended = session.state.ended
        last = min(after, newest)  # an id beyond it would wait for events that never come
        while not self._closed:
            change = self._store.changes.expect(session_id)
            try:
                events = await self._store.load_events(session_id, last)
            except NotFound:
                return
            except Unavailable:  # the stream outlives an outage of the store
                await wait_for_change(change, _PAUSE)
                if heartbeat is not None:
                    yield None
                continue
            for event in events:
                yield event
                last = event.id
                ended = ended or event.type == "end"
            if ended:
                return
            while not await wait_for_change(change, heartbeat):
                yield None
