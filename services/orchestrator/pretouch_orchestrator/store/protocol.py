"""The interface of session stores."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from pretouch.session import Session
from pretouch_orchestrator.sessions.record import Record


@dataclass(frozen=True)
class NewEvent:
    """An event of a session without its id: `type` is "session", "scan", "estimate" or "end"; `data` is JSON."""

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
    """Persistent sessions. Each method is one transaction, which is committed when it returns.

    Methods that take a session raise `NotFound` if it does not exist.
    """

    async def create(self, record: Record, events: Sequence[NewEvent], key: KeyedRequest | None) -> None:
        """Stores a new session with its first events and the idempotency key of its creation."""
        ...

    async def update(self, record: Record, events: Sequence[NewEvent]) -> None:
        """Stores the session's new state, its new scans, newly told samples of the next one, and its new events."""
        ...

    async def load_record(self, session_id: str) -> Record:
        """The complete record of a session."""
        ...

    async def load_session(self, session_id: str) -> Session:
        """A session as its client sees it."""
        ...

    async def list_sessions(self, limit: int, before: int | None) -> tuple[list[Session], int | None]:
        """At most `limit` sessions numbered below `before`, the newest first; the last one's number if more follow."""
        ...

    async def load_events(self, session_id: str, after: int) -> list[Event]:
        """The session's events whose id is greater than `after`."""
        ...

    async def find_keyed(self, key: str) -> tuple[KeyedRequest, str] | None:
        """The request that came with an idempotency key, and the id of the session that it created."""
        ...

    async def check(self) -> None:
        """Raises `Unavailable` if the store cannot write."""
        ...
