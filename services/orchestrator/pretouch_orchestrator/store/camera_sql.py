"""What the store reads and writes of cameras within a transaction."""

from __future__ import annotations

from typing import Any, NamedTuple

from pretouch.errors import NotFound
from pretouch_orchestrator.store.database import Transaction
from pretouch_orchestrator.store.protocol import MAX_CAMERAS, CameraChanged

MAX_COUNTED, MAX_LEFT_OUT = 200, 20
"""Newest sessions of each camera that are kept: of those that count, and of the others."""
CANCELLED = "It was cancelled."


class EntryColumns(NamedTuple):
    """What is written when a session of a camera ends; `reason` is empty, and `message` is not, if it counts."""

    session: str
    at: float
    reason: str
    message: bytes
    summary: bytes
    last: int
    """Number of the newest observation from which the summary was computed, besides this one."""


class CameraColumns(NamedTuple):
    """A camera's row, and its observations, the oldest first."""

    row: dict[str, Any]
    observations: list[dict[str, Any]]


def unknown_camera(camera_id: str) -> NotFound:
    return NotFound(
        f"There is no camera {camera_id!r:.80}.", "List the cameras, or name it as camera.id of a new session."
    )


def read_camera(tx: Transaction, owner: str, camera_id: str) -> CameraColumns | None:
    """None: no session of this owner has named it."""
    if not (camera_id.isascii() and camera_id.isprintable()):
        return None
    values = {"owner": owner, "id": camera_id}
    for row in tx.execute("SELECT * FROM camera WHERE owner = :owner AND id = :id", values):
        observations = tx.execute(
            "SELECT session, at, counts, reason, message FROM observation "
            "WHERE owner = :owner AND camera = :id ORDER BY number",
            values,
        )
        return CameraColumns(row, observations)
    return None


def store_camera(tx: Transaction, owner: str, camera_id: str, believed: bytes, summary: bytes) -> None:
    """Notes that a session names the camera; a new one is only remembered while its owner has room for it.

    Args:
        believed: its pose as the session believes it.
        summary: of a new one.
    """
    values = {"owner": owner, "id": camera_id, "believed": believed, "summary": summary, "limit": MAX_CAMERAS}
    tx.execute(
        "INSERT INTO camera (owner, id, believed, sessions, last, summary) "
        "SELECT :owner, :id, :believed, 0, 0, :summary WHERE "
        "(SELECT count(*) FROM camera WHERE owner = :owner AND id <> :id) < :limit "
        "ON CONFLICT (owner, id) DO UPDATE SET believed = excluded.believed",
        values,
    )


def store_entry(tx: Transaction, number: int, entry: EntryColumns) -> None:
    """Notes how the session of this number ended; nothing is noted of a camera that was forgotten meanwhile.

    Raises:
        CameraChanged: the session counts, and another one did since its summary was computed.
    """
    (names,) = tx.execute("SELECT owner, camera FROM session WHERE number = :number", {"number": number})
    # This first update also makes the ends of a camera's sessions wait for each other.
    found = tx.execute(
        "UPDATE camera SET sessions = sessions + :counts WHERE owner = :owner AND id = :camera RETURNING last",
        {**names, "counts": int(not entry.reason)},
    )
    if not found:
        return
    if not entry.reason and found[0]["last"] != entry.last:
        raise CameraChanged
    values = {
        **names,
        "session": entry.session,
        "at": entry.at,
        "counts": int(not entry.reason),
        "reason": entry.reason,
        "message": entry.message,
    }
    (stored,) = tx.execute(
        "INSERT INTO observation (owner, camera, session, at, counts, reason, message) "
        "VALUES (:owner, :camera, :session, :at, :counts, :reason, :message) RETURNING number",
        values,
    )
    if not entry.reason:
        tx.execute(
            "UPDATE camera SET last = :last, summary = :summary WHERE owner = :owner AND id = :camera",
            {**names, "last": stored["number"], "summary": entry.summary},
        )
    tx.execute(
        "DELETE FROM observation WHERE owner = :owner AND camera = :camera AND counts = :counts AND number <= "
        "(SELECT number FROM observation WHERE owner = :owner AND camera = :camera AND counts = :counts "
        "ORDER BY number DESC LIMIT 1 OFFSET :kept)",
        {**values, "kept": MAX_LEFT_OUT if entry.reason else MAX_COUNTED},
    )


def store_cancellation(tx: Transaction, number: int, session_id: str) -> None:
    """Notes that the session was cancelled, if it has a camera."""
    (now,) = tx.execute("SELECT epoch() AS at")
    store_entry(tx, number, EntryColumns(session_id, now["at"], CANCELLED, b"", b"", 0))


def forget_camera(tx: Transaction, owner: str, camera_id: str) -> bool:
    """Whether there was such a camera."""
    if not (camera_id.isascii() and camera_id.isprintable()):
        return False
    values = {"owner": owner, "id": camera_id}
    return bool(tx.execute("DELETE FROM camera WHERE owner = :owner AND id = :id RETURNING id", values))
