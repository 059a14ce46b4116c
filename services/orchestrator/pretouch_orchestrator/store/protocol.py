"""The interface of session stores."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from pretouch.calibrated_camera import CameraSummary
from pretouch.errors import Conflict
from pretouch.geometry import Pose
from pretouch.session import Session
from pretouch_orchestrator.calibration import Observation
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.store.changes import Changes


@dataclass(frozen=True)
class NewEvent:
    """An event of a session without its id: `type` is "session", "scan", "estimate", "camera" or "end"; `data` JSON."""

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


class Snapshot(NamedTuple):
    """A session as its client sees it, the version of its state, and the id of its newest event."""

    session: Session
    version: int
    last_event: int


class Owned(NamedTuple):
    """A session's name and its owner."""

    owner: str
    id: str


MAX_CAMERAS = 100
"""Cameras of an owner that are remembered."""


@dataclass(frozen=True, eq=False)
class CameraEntry:
    """How a session of a camera ended.

    Attributes:
        at: when, s since the Unix epoch.
        reason: why it does not count; empty if it does.
        observation: what it found; None if it does not count.
        error: m, mean distance by which the camera misplaced the object's points.
        expected_error: m, what was expected to be left of that by the session's prior.
    """

    session_id: str
    at: float
    reason: str = ""
    observation: Observation | None = None
    error: float = 0.0
    expected_error: float = 0.0


class CameraUpdate(NamedTuple):
    """What is stored of a session's camera when the session ends.

    Attributes:
        summary: of the camera with the session, if that counts; else None.
        last: number of the newest observation from which the summary was computed besides.
    """

    entry: CameraEntry
    summary: CameraSummary | None = None
    last: int = 0


@dataclass(frozen=True, eq=False)
class CameraMemory:
    """What is kept of a camera.

    Attributes:
        base_T_camera: as the newest session believed it.
        summary: what follows from the observations; its sessions are also those that are no longer kept.
        last: number of the newest observation.
        counted: the newest sessions that count, in the order in which they ended.
        left_out: the newest ones that do not.
    """

    base_T_camera: Pose
    summary: CameraSummary
    last: int
    counted: tuple[CameraEntry, ...]
    left_out: tuple[CameraEntry, ...]


class CameraChanged(Conflict):
    """Another session of the camera has ended since its summary was computed: load it and compute again."""

    def __init__(self) -> None:
        super().__init__("Another session of the camera ended meanwhile.", "Try again.")


class Stale(Conflict):
    """The state that an update was computed from is no longer the present one: load it and compute again."""

    def __init__(self) -> None:
        super().__init__("The session changed meanwhile.", "Read it, then go on from there.")


class Busy(Conflict):
    """Somebody else holds the session's lease: wait for a change, then try again."""

    def __init__(self) -> None:
        super().__init__("The session is in a step.", "Wait for the step's answer, then try again.")


class Store(Protocol):
    """Persistent sessions, which several processes may share. Each method is one transaction, committed on return.

    Methods that take a session raise `NotFound` if it does not exist or belongs to another owner than is given, and all
    raise `Unavailable` while the store cannot be used.

    Attributes:
        changes: announces each committed change of a session and each lease that ends, of all processes.
    """

    changes: Changes

    async def create(
        self,
        owner: str,
        record: Record,
        events: Sequence[NewEvent],
        key: KeyedRequest | None,
        camera: CameraUpdate | None = None,
    ) -> Record:
        """Stores a new session with its first events and the idempotency key of its creation; the record as stored.

        Args:
            camera: what is stored of its camera, where the session has already ended.

        Raises:
            Stale: the key has been used meanwhile.
        """
        ...

    async def update(
        self,
        before: Record,
        after: Record,
        events: Sequence[NewEvent],
        lease: str | None,
        camera: CameraUpdate | None = None,
    ) -> Record:
        """Stores what a step has changed, and its events; the record as stored.

        Args:
            lease: the holder of the session's lease, which ends with the step; None for a step that takes no lease.
            camera: what is stored of the session's camera, where the step ends the session.

        Raises:
            CameraChanged: another session of the camera has ended since `camera` was computed.
            Stale: `before` is not the present state.
            Busy: the step takes no lease, and another one holds the session's.
        """
        ...

    async def end(self, before: Snapshot, after: Session, events: Sequence[NewEvent]) -> None:
        """Ends a session whatever step is under way, which then finds itself stale; to its camera it does not count.

        Raises:
            Stale: `before` is not the present state.
        """
        ...

    async def load_record(self, owner: str, session_id: str, known: Record | None) -> Record:
        """The complete record of a session: `known` itself if it is the present state; else what `known` lacks is read.

        Args:
            known: any earlier state of the session.
        """
        ...

    async def load_session(self, owner: str, session_id: str) -> Snapshot:
        """A session as its client sees it."""
        ...

    async def load_camera(self, owner: str, camera_id: str) -> CameraMemory | None:
        """What is kept of a camera; None where no session of the owner has named it, or it was forgotten since."""
        ...

    async def list_cameras(self, owner: str) -> list[CameraSummary]:
        """The owner's cameras, in the order of their names."""
        ...

    async def forget_camera(self, owner: str, camera_id: str) -> None:
        """Removes what was learned of a camera, also by sessions that are still under way; raises `NotFound`."""
        ...

    async def is_present(self, record: Record) -> bool:
        """Whether the record is the session's present state."""
        ...

    async def list_sessions(self, owner: str, limit: int, before: int | None) -> tuple[list[Session], int | None]:
        """At most `limit` of the owner's sessions numbered below `before`, the newest first; the last one's number if
        more follow.
        """
        ...

    async def load_events(self, session_id: str, after: int, without: str = "") -> list[Event]:
        """The session's events whose id is greater than `after`, without those of the type `without`."""
        ...

    async def find_keyed(self, owner: str, key: str) -> tuple[KeyedRequest, str] | None:
        """The request that came with an idempotency key, and the id of the session that it created.

        Keys older than KEY_LIFETIME are forgotten.
        """
        ...

    async def acquire_lease(self, name: str, holder: str, seconds: float) -> bool:
        """Takes a lease for `seconds`; False if another holder has it."""
        ...

    async def renew_leases(self, holders: Sequence[str], seconds: float) -> None:
        """Extends the leases of these holders to `seconds` from now."""
        ...

    async def release_lease(self, name: str, holder: str) -> None:
        """Ends a lease, unless somebody else has taken it over."""
        ...

    async def find_ended(self, limit: int, untouched: float | None) -> list[Owned]:
        """At most `limit` ended sessions, the longest untouched first.

        Args:
            untouched: s for which they have not changed; None: those of any age.
        """
        ...

    async def find_abandoned(self, limit: int, untouched: float) -> list[Owned]:
        """At most `limit` sessions that have not ended and have not changed for `untouched` s."""
        ...

    async def remove(self, owner: str, session_id: str) -> None:
        """Removes a session and all that belongs to it; nothing where there is none."""
        ...

    async def tidy(self) -> None:
        """Forgets keys and leases that are past, and gives a little of the free space back to the file system."""
        ...

    async def used_bytes(self) -> int:
        """What the sessions take."""
        ...

    async def check(self) -> None:
        """Writes to the disk; raises `Unavailable` if that fails."""
        ...
