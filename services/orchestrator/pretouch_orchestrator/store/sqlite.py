"""The session store in one SQLite file, which one orchestrator uses."""

from __future__ import annotations

import asyncio
import fcntl
import os
import sqlite3
import time
from collections.abc import AsyncIterator, Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, asynccontextmanager, closing, suppress
from pathlib import Path
from typing import Any, TypeVar

from pretouch.errors import Unavailable
from pretouch.tracing import span
from pretouch_orchestrator.store.changes import Changes
from pretouch_orchestrator.store.database import Transaction
from pretouch_orchestrator.store.sql_store import SqlStore
from pretouch_orchestrator.store.sqlite_migrations import migrate

FILE_NAME = "sessions.sqlite"
_REMEDY = "Check the state directory's disk and permissions, then try again."
_SHRINK_PAGES = 1000
_SYSTEM = {"db.system": "sqlite"}
_MAX_REWRITTEN = 2**30
"""Bytes of an old file up to which it is rewritten as one that can shrink, which takes seconds."""
_MIN_FREE = 32 * 2**20
"""Bytes of free disk below which the store says that it is not ready: a large depth image and its log."""

T = TypeVar("T")


class _Transaction:
    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection
        self.topics: list[str] = []

    def execute(self, statement: str, values: Mapping[str, Any] = {}, /) -> list[dict[str, Any]]:
        with closing(self._connection.execute(statement, values)) as cursor:
            return cursor.fetchall()

    def announce(self, topic: str) -> None:
        self.topics.append(topic)


class SqliteDatabase:
    """A `Database` with a connection for writing and one for reading, each in its own thread.

    Readers see only complete transactions, and do not wait for the writer.
    """

    def __init__(self, path: Path, changes: Changes) -> None:
        self._folder = path.parent
        self._changes = changes
        self._writer, self._reader = _connect(path), _connect(path)
        self._writing = ThreadPoolExecutor(1, "pretouch-store-write")
        self._reading = ThreadPoolExecutor(1, "pretouch-store-read")

    async def read(self, work: Callable[[Transaction], T]) -> T:
        try:
            with span("store read", _SYSTEM):
                return (await _in_thread(self._reading, lambda: _run(self._reader, "BEGIN", work)))[0]
        except sqlite3.DatabaseError as error:
            raise _unavailable("read", error) from error

    async def write(self, work: Callable[[Transaction], T], *, patient: bool = True) -> T:
        try:
            with span("store write", _SYSTEM):
                result, topics = await _in_thread(self._writing, lambda: _run(self._writer, "BEGIN IMMEDIATE", work))
        except sqlite3.DatabaseError as error:
            raise _unavailable("written", error) from error
        for topic in topics:
            self._changes.announce(topic)
        return result

    def check_disk(self) -> None:
        try:
            disk = os.statvfs(self._folder)
        except OSError as error:
            raise Unavailable(f"The state directory {self._folder} cannot be read: {error}.", _REMEDY) from error
        free = disk.f_bavail * disk.f_frsize
        if free < _MIN_FREE:
            raise Unavailable(
                f"The disk of the state directory {self._folder} has {free / 2**20:.1f} MiB left; sessions need "
                f"{_MIN_FREE >> 20}.",
                "Make room on the disk.",
            )

    async def shrink(self) -> None:
        try:
            await _in_thread(self._writing, lambda: _shrink(self._writer))
        except sqlite3.DatabaseError as error:
            raise _unavailable("written", error) from error

    def close(self) -> None:
        for threads, connection in ((self._writing, self._writer), (self._reading, self._reader)):
            threads.shutdown()
            connection.close()


@asynccontextmanager
async def open_store(place: str | Path) -> AsyncIterator[SqlStore]:
    """Opens the store in the folder `place`, which is created if it does not exist, and migrates its tables.

    Raises:
        Unavailable: the folder is not usable, in use by another process, or written by a newer pretouch.
    """
    folder, changes = Path(place), Changes()
    with ExitStack() as stack:
        try:
            stack.callback(os.close, _acquire_lock(folder))
            await asyncio.to_thread(_prepare, folder / FILE_NAME)
            database = SqliteDatabase(folder / FILE_NAME, changes)
            stack.callback(database.close)
        except (OSError, sqlite3.Error) as error:
            raise Unavailable(f"The state directory {folder} cannot be used: {error}.", _REMEDY) from error
        # The lock says that no other process lives that could hold a lease.
        await database.write(lambda tx: tx.execute("DELETE FROM lease"))
        store = SqlStore(database, changes)
        stack.callback(store.close)
        yield store


def _acquire_lock(folder: Path) -> int:
    """A file descriptor that holds the lock of `folder`, which is created if it does not exist.

    The tables allow several orchestrators, but announcements of changes do not leave the process. The operating system
    releases the lock when the process ends, in whatever way.
    """
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    descriptor = os.open(folder / "lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(descriptor)
        raise Unavailable(
            f"Another orchestrator uses the state directory {folder}.", "Stop it, or give another directory."
        ) from error
    return descriptor


def _prepare(path: Path) -> None:
    """Creates the file or migrates it; only its owner may read it, or what SQLite puts beside it."""
    os.close(os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600))
    for file in (path, *(path.with_name(path.name + end) for end in ("-wal", "-shm")), path.with_name("lock")):
        if file.exists():
            file.chmod(0o600)
    path.parent.chmod(0o700)
    with closing(_connect(path)) as db:
        migrate(db, path.parent)
        (row,) = db.execute("PRAGMA auto_vacuum")
        if not row["auto_vacuum"] and path.stat().st_size < _MAX_REWRITTEN:
            with suppress(sqlite3.OperationalError):  # no room for a copy: its free pages are used again all the same
                db.execute("VACUUM")


def _connect(path: Path) -> sqlite3.Connection:
    db = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
    db.row_factory = _name_columns
    db.create_function("epoch", 0, time.time)
    db.execute("PRAGMA auto_vacuum = INCREMENTAL")  # of a new file, or one that is rewritten
    db.execute("PRAGMA journal_mode = WAL")
    db.execute(f"PRAGMA journal_size_limit = {_MIN_FREE}")
    # FULL: answered steps survive a power cut. Steps are seconds apart, so the fsync costs nothing.
    db.execute("PRAGMA synchronous = FULL")
    db.execute("PRAGMA foreign_keys = ON")
    return db


def _name_columns(cursor: sqlite3.Cursor, row: tuple[Any, ...]) -> dict[str, Any]:
    return {column[0]: value for column, value in zip(cursor.description, row, strict=True)}


async def _in_thread(threads: ThreadPoolExecutor, work: Callable[[], T]) -> T:
    return await asyncio.get_running_loop().run_in_executor(threads, work)


def _run(connection: sqlite3.Connection, begin: str, work: Callable[[Transaction], T]) -> tuple[T, list[str]]:
    """What `work` returns in a transaction of its own, and the topics to announce."""
    transaction = _Transaction(connection)
    try:
        connection.execute(begin)
        result = work(transaction)
        connection.execute("COMMIT")
    finally:
        if connection.in_transaction:
            connection.rollback()
    return result, transaction.topics


def _shrink(connection: sqlite3.Connection) -> None:
    # Each step frees one page, and `execute` makes a single one.
    connection.executescript(f"PRAGMA incremental_vacuum({_SHRINK_PAGES})")


def _unavailable(done: str, error: sqlite3.DatabaseError) -> Exception:
    """`error` itself if it is a defect of ours."""
    if isinstance(error, (sqlite3.IntegrityError, sqlite3.ProgrammingError, sqlite3.DataError)):
        return error
    return Unavailable(f"The session store cannot be {done}: {error}.", _REMEDY)
