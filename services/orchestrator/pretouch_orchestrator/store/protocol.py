"""What sessions ask of a store; `sqlite.py` has the one that ships."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from pretouch.session import Session
from pretouch_orchestrator.sessions.record import Record


@dataclass(frozen=True)
class NewEvent:
    """Something that happened in a session: `type` is "session", "scan", "estimate" or "end"; `data` is JSON."""

    type: str
    data: dict[str, Any]


@dataclass(frozen=True)
class Event(NewEvent):
    """An event with its `id`: 1, 2, ... within its session."""

    id: int


@dataclass(frozen=True)
class KeyedRequest:
    """An idempotency key, and the SHA-256 of the request that it came with."""

    key: str
    fingerprint: str


class Store(Protocol):
    """Sessions that outlive the process. Each method is one transaction, done once it returns.

    Methods that name a session raise `NotFound` where there is none.
    """

    async def create(self, record: Record, events: Sequence[NewEvent], key: KeyedRequest | None) -> None:
        """Keeps a new session with its first events and the idempotency key that led to it."""
        ...

    async def update(self, record: Record, events: Sequence[NewEvent]) -> None:
        """Keeps the session's new state, the scans that are new in it, and its next events."""
        ...

    async def record(self, session_id: str) -> Record:
        """All that is known of a session."""
        ...

    async def session(self, session_id: str) -> Session:
        """A session as its client sees it."""
        ...

    async def page(self, limit: int, before: int | None) -> tuple[list[Session], int | None]:
        """At most `limit` sessions, the newest first, older than number `before`; the last one's number if there are
        more."""
        ...

    async def events(self, session_id: str, after: int) -> list[Event]:
        """The session's events whose id is greater than `after`."""
        ...

    async def keyed(self, key: str) -> tuple[KeyedRequest, str] | None:
        """The request that came with an idempotency key and the id of the session it made."""
        ...

    async def check(self) -> None:
        """Raises `Unavailable` if the store cannot write."""
        ...
