"""The session store in one SQLite file."""

from __future__ import annotations

import asyncio
import fcntl
import json
import os
import sqlite3
from collections.abc import AsyncIterator, Sequence
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from importlib import resources
from pathlib import Path
from typing import Any

import aiosqlite

from pretouch.errors import NotFound, Unavailable
from pretouch.session import Session
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.store.protocol import Event, KeyedRequest, NewEvent
from pretouch_orchestrator.store.rows import (
    beams_column,
    changing_columns,
    fixed_columns,
    record_from_columns,
    samples_column,
    session_from_view,
)

FILE_NAME = "sessions.sqlite"


def load_migrations() -> list[str]:
    """The scripts that migrate an empty file to the present schema; `PRAGMA user_version` counts the applied ones."""
    folder = resources.files(__package__) / "migrations"
    names = sorted(entry.name for entry in folder.iterdir() if entry.name.endswith(".sql"))
    return [(folder / name).read_text("utf-8") for name in names]


class SqliteStore:
    """A `Store` with a connection for writing and one for reading, so that readers see only complete transactions."""

    def __init__(self, writer: aiosqlite.Connection, reader: aiosqlite.Connection) -> None:
        self._writer = writer
        self._reader = reader
        self._writing = asyncio.Lock()

    async def create(self, record: Record, events: Sequence[NewEvent], key: KeyedRequest | None) -> None:
        columns = await asyncio.to_thread(lambda: fixed_columns(record) | changing_columns(record))
        async with self._transaction() as db:
            marks = ", ".join(f":{name}" for name in columns)
            await _execute(db, f"INSERT INTO session ({', '.join(columns)}) VALUES ({marks})", columns)
            number = await _find_number(db, record.id)
            await _append(db, number, record, events)
            if key is not None:
                await _execute(
                    db,
                    "INSERT INTO idempotency_key (key, fingerprint, session) VALUES (?, ?, ?)",
                    (key.key, key.fingerprint, number),
                )

    async def update(self, record: Record, events: Sequence[NewEvent]) -> None:
        columns = await asyncio.to_thread(changing_columns, record)
        async with self._transaction() as db:
            number = await _find_number(db, record.id)
            changes = ", ".join(f"{name} = :{name}" for name in columns)
            await _execute(db, f"UPDATE session SET {changes} WHERE number = :number", columns | {"number": number})
            await _append(db, number, record, events)

    async def load_record(self, session_id: str) -> Record:
        row = await self._read_one("SELECT * FROM session WHERE id = ?", session_id)
        beams = await self._read("SELECT beams FROM scan WHERE session = ? ORDER BY position", (row["number"],))
        told = await self._read("SELECT samples FROM told WHERE session = ? ORDER BY position", (row["number"],))
        return await asyncio.to_thread(
            record_from_columns, dict(row), [scan["beams"] for scan in beams], [chunk["samples"] for chunk in told]
        )

    async def load_session(self, session_id: str) -> Session:
        return session_from_view((await self._read_one("SELECT view FROM session WHERE id = ?", session_id))["view"])

    async def list_sessions(self, limit: int, before: int | None) -> tuple[list[Session], int | None]:
        rows = await self._read(
            "SELECT number, view FROM session WHERE number < ? ORDER BY number DESC LIMIT ?",
            (2**63 - 1 if before is None else before, limit + 1),
        )
        kept = rows[:limit]
        sessions = await asyncio.to_thread(lambda: [session_from_view(row["view"]) for row in kept])
        return sessions, kept[-1]["number"] if len(rows) > limit else None

    async def load_events(self, session_id: str, after: int) -> list[Event]:
        number = (await self._read_one("SELECT number FROM session WHERE id = ?", session_id))["number"]
        rows = await self._read(
            "SELECT id, type, data FROM event WHERE session = ? AND id > ? ORDER BY id", (number, after)
        )
        return [Event(row["type"], json.loads(row["data"]), row["id"]) for row in rows]

    async def find_keyed(self, key: str) -> tuple[KeyedRequest, str] | None:
        rows = await self._read(
            "SELECT fingerprint, id FROM idempotency_key JOIN session ON number = session WHERE key = ?", (key,)
        )
        return (KeyedRequest(key, rows[0]["fingerprint"]), rows[0]["id"]) if rows else None

    async def check(self) -> None:
        async with self._transaction() as db:
            await _execute(db, "UPDATE session SET number = number WHERE 0", ())

    @asynccontextmanager
    async def _transaction(self) -> AsyncIterator[aiosqlite.Connection]:
        async with self._writing:
            try:
                await _execute(self._writer, "BEGIN IMMEDIATE", ())
                yield self._writer
                await self._writer.commit()
            except sqlite3.OperationalError as error:
                raise Unavailable(f"The session store cannot be written: {error}.", _REMEDY) from error
            finally:
                with suppress(sqlite3.Error):
                    await asyncio.shield(self._writer.rollback())

    async def _read(self, statement: str, values: tuple[Any, ...]) -> list[sqlite3.Row]:
        try:
            return list(await self._reader.execute_fetchall(statement, values))
        except sqlite3.OperationalError as error:
            raise Unavailable(f"The session store cannot be read: {error}.", _REMEDY) from error

    async def _read_one(self, statement: str, session_id: str) -> sqlite3.Row:
        rows = await self._read(statement, (session_id,))
        if not rows:
            raise _not_found(session_id)
        return rows[0]


_REMEDY = "Check the state directory's disk and permissions, then try again."


@asynccontextmanager
async def open_store(place: str | Path) -> AsyncIterator[SqliteStore]:
    """Opens the store in the folder `place`, which is created if it does not exist, and migrates its tables.

    Raises:
        Unavailable: the folder is not usable, in use by another process, or written by a newer pretouch.
    """
    folder = Path(place)
    async with AsyncExitStack() as stack:
        try:
            stack.callback(os.close, _acquire_lock(folder))
            writer = await stack.enter_async_context(_connect(folder / FILE_NAME))
            await _migrate(writer, folder)
            reader = await stack.enter_async_context(_connect(folder / FILE_NAME))
            await reader.execute_fetchall("PRAGMA query_only = ON")
        except (OSError, sqlite3.Error) as error:
            raise Unavailable(f"The state directory {folder} cannot be used: {error}.", _REMEDY) from error
        yield SqliteStore(writer, reader)


def _acquire_lock(folder: Path) -> int:
    """A file descriptor that holds the lock of `folder`, which is created if it does not exist.

    Two orchestrators on one store would answer a session twice. The operating system releases the lock when the process
    ends, in whatever way.
    """
    folder.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(folder / "lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(descriptor)
        raise Unavailable(
            f"Another orchestrator uses the state directory {folder}.", "Stop it, or give another directory."
        ) from error
    return descriptor


@asynccontextmanager
async def _connect(path: Path) -> AsyncIterator[aiosqlite.Connection]:
    async with aiosqlite.connect(path, isolation_level=None) as db:
        db.row_factory = sqlite3.Row
        await db.execute_fetchall("PRAGMA journal_mode = WAL")
        # FULL: answered steps survive a power cut. Steps are seconds apart, so the fsync costs nothing.
        await db.execute_fetchall("PRAGMA synchronous = FULL")
        await db.execute_fetchall("PRAGMA foreign_keys = ON")
        yield db


async def _migrate(db: aiosqlite.Connection, folder: Path) -> None:
    scripts = load_migrations()
    ((applied,),) = await db.execute_fetchall("PRAGMA user_version")
    if applied > len(scripts):
        raise Unavailable(
            f"The store in {folder} has version {applied}; this pretouch supports versions up to {len(scripts)}.",
            "Use a pretouch at least as new as the one that wrote it, or choose another directory.",
        )
    for version, script in enumerate(scripts[applied:], start=applied + 1):
        await db.executescript(f"BEGIN; {script}; PRAGMA user_version = {version}; COMMIT;")


async def _find_number(db: aiosqlite.Connection, session_id: str) -> int:
    for (number,) in await db.execute_fetchall("SELECT number FROM session WHERE id = ?", (session_id,)):
        return int(number)
    raise _not_found(session_id)


async def _append(db: aiosqlite.Connection, number: int, record: Record, events: Sequence[NewEvent]) -> None:
    """Inserts the scans and told samples that are not stored yet, and the events; drops those told of a closed one."""
    ((kept, told, last_event),) = await db.execute_fetchall(
        "SELECT (SELECT count(*) FROM scan WHERE session = :n), (SELECT count(*) FROM told WHERE session = :n), "
        "(SELECT coalesce(max(id), 0) FROM event WHERE session = :n)",
        {"n": number},
    )
    for position in range(kept, len(record.measured)):
        values = (number, position, beams_column(record.measured[position]))
        await _execute(db, "INSERT INTO scan (session, position, beams) VALUES (?, ?, ?)", values)
    if not record.told:
        await _execute(db, "DELETE FROM told WHERE session = ?", (number,))
    for position in range(told, len(record.told)):
        values = (number, position, samples_column(record.told[position]))
        await _execute(db, "INSERT INTO told (session, position, samples) VALUES (?, ?, ?)", values)
    for event_id, event in enumerate(events, start=last_event + 1):
        row = (number, event_id, event.type, json.dumps(event.data))
        await _execute(db, "INSERT INTO event (session, id, type, data) VALUES (?, ?, ?, ?)", row)


async def _execute(db: aiosqlite.Connection, statement: str, values: Any) -> None:
    await (await db.execute(statement, values)).close()


def _not_found(session_id: str) -> NotFound:
    return NotFound(f"There is no session {session_id!r:.80}.", "List the sessions, or create one.")
