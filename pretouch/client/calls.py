"""The calls of the orchestrator without their transport: what to send, and how to read the answer."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from pretouch.client.images import ImageLike
from pretouch.session import ScanPlan, Session, SessionRequest, Submission

Q = TypeVar("Q")
"""What a transport sends."""
A = TypeVar("A")
"""What it gets back."""
T = TypeVar("T")


@dataclass(frozen=True)
class SessionPage:
    """Some sessions, the newest first; `next` is the cursor of the page after, empty on the last one."""

    sessions: tuple[Session, ...]
    next: str


@dataclass(frozen=True)
class Call(Generic[Q, A, T]):
    """One call: the message to send, and what turns the answer into its result or raises the pretouch error in it."""

    message: Q
    parse: Callable[[A], T]


class Calls(ABC, Generic[Q, A]):
    """The orchestrator's calls, built for one transport."""

    @abstractmethod
    def create_session(
        self, request: SessionRequest, depth: ImageLike, mask: ImageLike | None, idempotency_key: str | None
    ) -> Call[Q, A, Session]:
        """Without a key one is made, so that a call that arrives twice opens one session."""

    @abstractmethod
    def session(self, session_id: str) -> Call[Q, A, Session]: ...

    @abstractmethod
    def sessions(self, limit: int, cursor: str) -> Call[Q, A, SessionPage]: ...

    @abstractmethod
    def next_scan(self, session_id: str) -> Call[Q, A, ScanPlan]: ...

    @abstractmethod
    def submit(self, session_id: str, scan_id: str, submission: Submission) -> Call[Q, A, Session]: ...

    @abstractmethod
    def cancel(self, session_id: str) -> Call[Q, A, None]: ...
