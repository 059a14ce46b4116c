"""The orchestrator's session API without I/O: which message each call sends, and how its answer is decoded.

`rest_api.py` and `grpc_api.py` implement it for the two protocols; the clients send the messages.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from pretouch.calibrated_camera import CalibratedCamera, CameraSummary
from pretouch.client.images import ImageLike
from pretouch.session import ScanPlan, ScanProgress, Session, SessionRequest, Submission, Telling

MessageT = TypeVar("MessageT")
"""A request in the protocol's own form."""
AnswerT = TypeVar("AnswerT")
"""A response in the protocol's own form."""
ResultT = TypeVar("ResultT")
"""What the call returns to the program."""


@dataclass(frozen=True)
class SessionPage:
    """Some sessions, the newest first; `next` is the cursor of the following page, empty on the last one."""

    sessions: tuple[Session, ...]
    next: str


@dataclass(frozen=True)
class Call(Generic[MessageT, AnswerT, ResultT]):
    """One call: the message to send, and the function that decodes its answer.

    `parse` raises the `PretouchError` that the answer stands for, or `Internal` if it cannot be decoded.
    """

    message: MessageT
    parse: Callable[[AnswerT], ResultT]


class SessionApi(ABC, Generic[MessageT, AnswerT]):
    """Builds the calls of the orchestrator's session API for one protocol."""

    @abstractmethod
    def create_session(
        self, request: SessionRequest, depth: ImageLike, mask: ImageLike | None, idempotency_key: str | None
    ) -> Call[MessageT, AnswerT, Session]:
        """Without a key, one is generated, so that a call that is retried creates one session."""

    @abstractmethod
    def session(self, session_id: str) -> Call[MessageT, AnswerT, Session]: ...

    @abstractmethod
    def sessions(self, limit: int, cursor: str) -> Call[MessageT, AnswerT, SessionPage]: ...

    @abstractmethod
    def next_scan(self, session_id: str) -> Call[MessageT, AnswerT, ScanPlan]: ...

    @abstractmethod
    def submit(self, session_id: str, scan_id: str, submission: Submission) -> Call[MessageT, AnswerT, Session]: ...

    @abstractmethod
    def tell(self, session_id: str, scan_id: str, telling: Telling) -> Call[MessageT, AnswerT, ScanProgress]: ...

    @abstractmethod
    def cancel(self, session_id: str, purge: bool) -> Call[MessageT, AnswerT, None]: ...

    @abstractmethod
    def cameras(self) -> Call[MessageT, AnswerT, tuple[CameraSummary, ...]]: ...

    @abstractmethod
    def camera(self, camera_id: str) -> Call[MessageT, AnswerT, CalibratedCamera]: ...

    @abstractmethod
    def forget_camera(self, camera_id: str) -> Call[MessageT, AnswerT, None]: ...
