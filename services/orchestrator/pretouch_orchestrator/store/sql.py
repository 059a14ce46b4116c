"""What the store reads and writes within a transaction."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from pretouch.errors import NotFound
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.store import rows
from pretouch_orchestrator.store.database import Transaction
from pretouch_orchestrator.store.protocol import KeyedRequest, Stale

KEY_LIFETIME = 24 * 3600.0
"""s for which an idempotency key is remembered."""


def find(tx: Transaction, owner: str, session_id: str) -> dict[str, Any]:
    """The session's row."""
    if session_id.isascii() and session_id.isprintable():
        values = {"id": session_id, "owner": owner}
        for row in tx.execute("SELECT * FROM session WHERE id = :id AND owner = :owner", values):
            return row
    raise not_found(session_id)


def not_found(session_id: str) -> NotFound:
    return NotFound(f"There is no session {session_id!r:.80}.", "List the sessions, or create one.")


def read_view(tx: Transaction, number: int) -> bytes:
    (row,) = tx.execute("SELECT message FROM view WHERE session = :number", {"number": number})
    return bytes(row["message"])


def read_record(tx: Transaction, owner: str, session_id: str, known: Record | None) -> rows.RecordColumns | None:
    """What is read of a session, given an earlier state; None if that is the present one."""
    row = find(tx, owner, session_id)
    if known is not None and known.version == row["version"]:
        return None
    if known is not None and known.version > row["version"]:
        known = None  # the database was restored from a backup
    number = row["number"]
    scene = None
    if known is None:
        (found,) = tx.execute("SELECT message FROM scene WHERE digest = :scene", {"scene": row["scene"]})
        scene = found["message"]
    beams = tx.execute(
        "SELECT beams FROM scan WHERE session = :number AND position >= :seen ORDER BY position",
        {"number": number, "seen": len(known.measured) if known else 0},
    )
    # The same scan is pending as long as no other was answered, and what was told of it can only have grown.
    continued = known is not None and not row["ended"] and json.loads(row["answered"]) == list(known.answered)
    told_before = len(known.told) if known and continued else 0
    told = tx.execute(
        "SELECT samples FROM told WHERE session = :number AND position >= :seen ORDER BY position",
        {"number": number, "seen": told_before},
    )
    return rows.RecordColumns(
        row,
        read_view(tx, number),
        scene,
        [scan["beams"] for scan in beams],
        [chunk["samples"] for chunk in told],
        told_before,
    )


def next_version(tx: Transaction, session_id: str, version: int) -> int:
    """Moves the session from this version to the next; its number."""
    moved = tx.execute(
        "UPDATE session SET version = version + 1, touched = epoch() WHERE id = :id AND version = :version "
        "RETURNING number",
        {"id": session_id, "version": version},
    )
    if not moved:
        exists = tx.execute("SELECT 1 FROM session WHERE id = :id", {"id": session_id})
        raise Stale if exists else not_found(session_id)
    return int(moved[0]["number"])


def store_step(tx: Transaction, number: int, step: rows.StepColumns) -> None:
    tx.execute(
        "UPDATE session SET skipped = :skipped, answered = :answered, ended = :ended, size = size + :size "
        "WHERE number = :number",
        {
            "number": number,
            "skipped": step.skipped,
            "answered": step.answered,
            "ended": step.ended,
            "size": step.size,
        },
    )
    if step.view is not None:
        store_view(tx, number, step.view)
    if step.first_samples == 0:
        tx.execute("DELETE FROM told WHERE session = :number", {"number": number})
    for position, beams in enumerate(step.beams, step.first_beams):
        tx.execute(
            "INSERT INTO scan (session, position, beams) VALUES (:number, :position, :beams)",
            {"number": number, "position": position, "beams": beams},
        )
    for position, samples in enumerate(step.samples, step.first_samples):
        tx.execute(
            "INSERT INTO told (session, position, samples) VALUES (:number, :position, :samples)",
            {"number": number, "position": position, "samples": samples},
        )
    store_events(tx, number, step.events)


def store_view(tx: Transaction, number: int, view: bytes) -> None:
    tx.execute(
        "INSERT INTO view (session, message) VALUES (:number, :view) "
        "ON CONFLICT (session) DO UPDATE SET message = excluded.message",
        {"number": number, "view": view},
    )


def store_events(tx: Transaction, number: int, events: Sequence[tuple[str, str]]) -> None:
    (row,) = tx.execute(
        "UPDATE session SET last_event = last_event + :count WHERE number = :number RETURNING last_event",
        {"count": len(events), "number": number},
    )
    last = row["last_event"]
    for event_id, (kind, data) in enumerate(events, last - len(events) + 1):
        tx.execute(
            "INSERT INTO event (session, id, type, data) VALUES (:number, :id, :type, :data)",
            {"number": number, "id": event_id, "type": kind, "data": data},
        )


def store_scene(tx: Transaction, digest: bytes, message: bytes) -> None:
    """Stores a scene unless it is there already; another process may do so at the same time."""
    if not tx.execute("SELECT 1 FROM scene WHERE digest = :digest", {"digest": digest}):
        tx.execute(
            "INSERT INTO scene (digest, size, message) VALUES (:digest, :size, :message) "
            "ON CONFLICT (digest) DO NOTHING",
            {"digest": digest, "size": len(message), "message": message},
        )


def store_key(tx: Transaction, owner: str, key: KeyedRequest, number: int) -> bool:
    """Whether the idempotency key was free."""
    return bool(
        tx.execute(
            "INSERT INTO idempotency_key (owner, key, fingerprint, session, created) "
            "VALUES (:owner, :key, :fingerprint, :number, epoch()) ON CONFLICT (owner, key) DO UPDATE "
            "SET fingerprint = excluded.fingerprint, session = excluded.session, created = excluded.created "
            "WHERE idempotency_key.created <= epoch() - :lifetime RETURNING key",
            {
                "owner": owner,
                "key": key.key,
                "fingerprint": key.fingerprint,
                "number": number,
                "lifetime": KEY_LIFETIME,
            },
        )
    )


def is_leased(tx: Transaction, name: str) -> bool:
    return bool(tx.execute("SELECT 1 FROM lease WHERE name = :name AND until > epoch()", {"name": name}))


def release_lease(tx: Transaction, name: str, holder: str) -> None:
    if tx.execute(
        "DELETE FROM lease WHERE name = :name AND holder = :holder RETURNING name", {"name": name, "holder": holder}
    ):
        tx.announce(name)
