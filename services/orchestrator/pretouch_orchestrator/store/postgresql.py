"""The session store in a PostgreSQL database, which any number of orchestrators may share."""

from __future__ import annotations

import asyncio
import os
import re
import secrets
import socket
import threading
import time
from collections.abc import AsyncIterator, Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, asynccontextmanager, suppress
from functools import cache
from typing import Any, TypeVar

import psycopg
import structlog
from psycopg.rows import dict_row

from pretouch.errors import Unavailable
from pretouch.tracing import span
from pretouch_orchestrator.store.changes import Changes
from pretouch_orchestrator.store.database import Transaction
from pretouch_orchestrator.store.postgresql_migrations import migrate
from pretouch_orchestrator.store.sql_store import SqlStore

CHANNEL = "pretouch"
_CONNECTIONS = 8
_PATIENCE = 4.0
"""s for which a transaction is tried again while the database cannot be reached."""
_START_PATIENCE = 30.0
"""s that a start waits for the database, which may start at the same time."""
_LONGEST = 8.0
"""s that a transaction may take; the server's own limit of a statement is shorter, but it may hang."""
_PAUSE = 0.5
"""s between two tries."""
_LISTEN_HEARTBEAT = 3.0
"""s without a notification after which the connection is tried, and, without one, everyone looks for changes."""
_REMEDY = "Check that PostgreSQL runs, can be reached, and has room on its disk; then try again."
# A server that vanished from the network is noticed within seconds, not after TCP's quarter of an hour.
_CONNECTION: dict[str, Any] = {
    "connect_timeout": 3,
    "keepalives_idle": 3,
    "keepalives_interval": 1,
    "keepalives_count": 3,
    "tcp_user_timeout": 5000,
    "application_name": "pretouch-orchestrator",
}
_SYSTEM = {"db.system": "postgresql"}
_SESSION = "SET statement_timeout = '5s'; SET lock_timeout = '5s'; SET idle_in_transaction_session_timeout = '10s'"
_TRANSIENT = (psycopg.OperationalError, psycopg.InterfaceError, psycopg.errors.ReadOnlySqlTransaction)
_RACES = (psycopg.errors.ForeignKeyViolation, psycopg.errors.UniqueViolation)
"""What another process's transaction of the same moment can cause; the second try finds what that one stored."""

T = TypeVar("T")
_log = structlog.get_logger()


class _Transaction:
    def __init__(self, connection: psycopg.Connection[dict[str, Any]], process: str) -> None:
        self._cursor = connection.cursor(binary=True)
        self._process = process
        self.topics: list[str] = []

    def execute(self, statement: str, values: Mapping[str, Any] = {}, /) -> list[dict[str, Any]]:
        self._cursor.execute(_translate(statement), values)
        return self._cursor.fetchall() if self._cursor.description else []

    def announce(self, topic: str) -> None:
        self.topics.append(topic)
        self._cursor.execute(
            "SELECT pg_notify(%(channel)s, %(payload)s)", {"channel": CHANNEL, "payload": f"{self._process} {topic}"}
        )


@cache
def _translate(statement: str) -> bytes:
    """The statement with psycopg's way of writing parameters."""
    return re.sub(r":([a-z_]+)", r"%(\1)s", statement).encode()


class PostgresqlDatabase:
    """A `Database` whose threads have a connection each, opened when needed and again when lost.

    Every transaction may be tried again, even one whose commit may have been done: a version or a key fences it. So
    a restart of the server costs a moment, no step. psycopg_pool is not used: the threads are the pool, and
    one that cannot connect says so at once.
    """

    def __init__(self, address: str, changes: Changes) -> None:
        self._address = address
        self._changes = changes
        self.process = secrets.token_hex(8)
        self._threads = ThreadPoolExecutor(_CONNECTIONS, "pretouch-store")
        self._local = threading.local()
        self._connections: set[psycopg.Connection[dict[str, Any]]] = set()
        self._down_until = 0.0
        self._down_because = ""

    async def read(self, work: Callable[[Transaction], T]) -> T:
        with span("store read", _SYSTEM):
            result, _ = await self._retry("read", work, "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY", _PATIENCE)
        return result

    async def write(self, work: Callable[[Transaction], T], *, patient: bool = True) -> T:
        patience = _PATIENCE if patient else _PAUSE
        with span("store write", _SYSTEM):
            result, topics = await self._retry("written", work, "BEGIN ISOLATION LEVEL READ COMMITTED", patience)
        for topic in topics:
            self._changes.announce(topic)
        return result

    def check_disk(self) -> None:
        """Nothing to see: the disk is the server's, which refuses to write to a full one."""

    async def shrink(self) -> None:
        """Nothing to do: autovacuum makes free space usable again."""

    def close(self) -> None:
        self._threads.shutdown()
        for connection in self._connections:
            connection.close()

    async def _retry(
        self, done: str, work: Callable[[Transaction], T], begin: str, patience: float
    ) -> tuple[T, list[str]]:
        until = time.monotonic() + patience
        while True:
            try:
                return await self._run_in_thread(work, begin)
            except (*_TRANSIENT, *_RACES) as error:
                if time.monotonic() > until:
                    if isinstance(error, _RACES):
                        raise
                    message = f"The session store cannot be {done}: {_describe(error)}."
                    raise Unavailable(message, _REMEDY, retry_after=2.0) from error
            await asyncio.sleep(_PAUSE)

    async def _run_in_thread(self, work: Callable[[Transaction], T], begin: str) -> tuple[T, list[str]]:
        """Runs the transaction; one that a server does not answer is cut off, wherever it hangs."""
        used: list[psycopg.Connection[dict[str, Any]]] = []
        running = asyncio.get_running_loop().run_in_executor(self._threads, lambda: self._run(work, begin, used))
        while not (await asyncio.wait({running}, timeout=_LONGEST))[0]:
            if used:
                with suppress(OSError), socket.socket(fileno=os.dup(used[0].fileno())) as line:
                    line.shutdown(socket.SHUT_RDWR)
            elif running.cancel():
                raise psycopg.OperationalError("every connection waits for an answer")
        return running.result()

    def _run(
        self, work: Callable[[Transaction], T], begin: str, used: list[psycopg.Connection[dict[str, Any]]]
    ) -> tuple[T, list[str]]:
        """What `work` returns, and the topics to announce; `used` is given the connection."""
        connection = self._connect()
        used.append(connection)
        transaction = _Transaction(connection, self.process)
        try:
            connection.execute(begin)
            result = work(transaction)
            connection.execute("COMMIT")
        except BaseException:
            self._roll_back(connection)
            raise
        return result, transaction.topics

    def _roll_back(self, connection: psycopg.Connection[dict[str, Any]]) -> None:
        """Rolls back; a connection that was lost is dropped."""
        with suppress(psycopg.Error):
            connection.execute("ROLLBACK")
        if connection.broken or connection.closed:
            self._connections.discard(connection)
            self._local.connection = None
            connection.close()

    def _connect(self) -> psycopg.Connection[dict[str, Any]]:
        """This thread's connection.

        After a failure no thread tries for a second: callers are told at once instead of queueing for a server
        that does not answer.
        """
        connection: psycopg.Connection[dict[str, Any]] | None = getattr(self._local, "connection", None)
        if connection is not None:
            return connection
        if time.monotonic() < self._down_until:
            raise psycopg.OperationalError(self._down_because)
        try:
            connection = psycopg.connect(self._address, autocommit=True, row_factory=dict_row, **_CONNECTION)
            connection.execute(_SESSION)
        except psycopg.Error as error:
            self._down_because = _describe(error)
            self._down_until = time.monotonic() + 1.0
            raise
        self._connections.add(connection)
        self._local.connection = connection
        return connection


@asynccontextmanager
async def open_store(place: str) -> AsyncIterator[SqlStore]:
    """Opens the store in the database at `place`, which is a URL without its scheme, and migrates its tables.

    Raises:
        Unavailable: the database cannot be reached, or was written by a newer pretouch.
    """
    address, changes = f"postgresql:{place}", Changes()
    await _migrate_once_there(address)
    with ExitStack() as stack:
        database = PostgresqlDatabase(address, changes)
        stack.callback(database.close)
        store = SqlStore(database, changes)
        stack.callback(store.close)
        listening = asyncio.create_task(_listen(address, database.process, changes))
        try:
            yield store
        finally:
            listening.cancel()
            await asyncio.wait({listening}, timeout=_LONGEST)  # a server that hangs may not answer to the end


async def _migrate_once_there(address: str) -> None:
    until = time.monotonic() + _START_PATIENCE
    while True:
        try:
            return await asyncio.to_thread(migrate, address, _CONNECTION)
        except psycopg.OperationalError as error:
            if time.monotonic() > until:
                raise Unavailable(f"The session store cannot be opened: {_describe(error)}.", _REMEDY) from error
        except psycopg.Error as error:
            raise Unavailable(f"The session store cannot be opened: {_describe(error)}.", _REMEDY) from error
        await asyncio.sleep(1.0)


async def _listen(address: str, process: str, changes: Changes) -> None:
    """Announces the changes of other processes; without a connection everyone looks for changes every few seconds."""
    while True:
        try:
            async with await psycopg.AsyncConnection.connect(address, autocommit=True, **_CONNECTION) as connection:
                await connection.execute(f"LISTEN {CHANNEL}")
                changes.announce_all()
                while True:
                    async for notification in connection.notifies(timeout=_LISTEN_HEARTBEAT):
                        sender, _, topic = notification.payload.partition(" ")
                        if sender != process:
                            changes.announce(topic)
                    async with asyncio.timeout(_LISTEN_HEARTBEAT):
                        await connection.execute("SELECT 1")
        except (psycopg.Error, TimeoutError) as error:
            _log.warning("changes of other orchestrators are polled", problem=_describe(error))
        changes.announce_all()
        await asyncio.sleep(1.0)


def _describe(error: BaseException) -> str:
    """The first line of what the database says."""
    return (str(error).strip() or type(error).__name__).splitlines()[0].rstrip(".")
