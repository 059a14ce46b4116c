"""Stores as earlier versions of pretouch wrote them; run as a program it is killed while it migrates them.

python -m helpers.old_store FILE FOLDER    for each moment of the migration: a copy in FOLDER/N, left by a SIGKILL
"""

from __future__ import annotations

import os
import shutil
import signal
import sqlite3
import sys
from contextlib import closing
from pathlib import Path

import psycopg
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.store import postgresql, rows, sqlite, sqlite_migrations
from pretouch_orchestrator.store.database import Transaction
from pretouch_orchestrator.store.migrations import load_migrations
from psycopg.rows import dict_row

KEY, FINGERPRINT = "a key", "the fingerprint"


def write_old_store(path: Path, version: int, records: list[Record]) -> None:
    """A file of version 1 to 3 with these sessions, two events each; the first has the idempotency key KEY."""
    path.parent.mkdir(parents=True)
    with closing(sqlite3.connect(path)) as db, db:
        for function in (rows.scene_digest, rows.view_ended):
            db.create_function(function.__name__, 1, function, deterministic=True)
        for script in load_migrations("sqlite")[:version]:
            db.executescript(script)
        db.execute(f"PRAGMA user_version = {version}")
        db.execute("PRAGMA journal_mode = WAL")
        if version == 3:
            db.row_factory = sqlite._name_columns
            _write_before_cameras(sqlite._Transaction(db), records)
            return
        for number, record in enumerate(records, start=1):
            db.execute(
                "INSERT INTO session (id, created, request, scene, origin, view, skipped, answered) "
                "VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
                (
                    record.id,
                    record.created,
                    rows.request_column(record),
                    rows.scene_column(record),
                    "[{}, {}]".format(*record.origin),
                    rows.view_column(record.to_session()),
                    str(list(record.skipped)).replace("'", '"'),
                    str(list(record.answered)).replace("'", '"'),
                ),
            )
            step = rows.StepColumns.between(None, record, [])
            for name, column, blobs in (("scan", "beams", step.beams), ("told", "samples", step.samples)):
                for position, blob in enumerate(blobs):
                    db.execute(
                        f"INSERT INTO {name} (session, position, {column}) VALUES (?, ?, ?)", (number, position, blob)
                    )
            for event_id in (1, 2):
                values = (number, event_id, "session", f'{{"n": {event_id}}}')
                db.execute("INSERT INTO event (session, id, type, data) VALUES (?, ?, ?, ?)", values)
        db.execute("INSERT INTO idempotency_key (key, fingerprint, session) VALUES (?, ?, 1)", (KEY, FINGERPRINT))


def write_old_postgresql(address: str, records: list[Record]) -> None:
    """The same in a PostgreSQL database of version 1, whose tables are those of a file of version 3."""
    with psycopg.connect(address, row_factory=dict_row) as connection:
        connection.execute(load_migrations("postgresql")[0].encode())
        connection.execute("CREATE TABLE schema_version (version BIGINT PRIMARY KEY)")
        connection.execute("INSERT INTO schema_version (version) VALUES (1)")
        _write_before_cameras(postgresql._Transaction(connection, "old"), records)


def _write_before_cameras(tx: Transaction, records: list[Record]) -> None:
    for record in records:
        message, request = rows.scene_column(record), rows.request_column(record)
        step = rows.StepColumns.between(None, record, [])
        tx.execute(
            "INSERT INTO scene (digest, size, message) VALUES (:digest, :size, :message) "
            "ON CONFLICT (digest) DO NOTHING",
            {"digest": record.scene.digest, "size": len(message), "message": message},
        )
        (row,) = tx.execute(
            "INSERT INTO session (id, owner, created, request, scene, origin, version, touched, ended, last_event, "
            "size, skipped, answered) VALUES (:id, '', :created, :request, :scene, :origin, 1, :created, :ended, 2, "
            ":size, :skipped, :answered) RETURNING number",
            {
                "id": record.id,
                "created": record.created,
                "request": request,
                "scene": record.scene.digest,
                "origin": "[{}, {}]".format(*record.origin),
                "ended": step.ended,
                "size": len(request) + step.size,
                "skipped": step.skipped,
                "answered": step.answered,
            },
        )
        number = row["number"]
        tx.execute("INSERT INTO view (session, message) VALUES (:number, :view)", {"number": number, "view": step.view})
        for name, column, blobs in (("scan", "beams", step.beams), ("told", "samples", step.samples)):
            for position, blob in enumerate(blobs):
                tx.execute(
                    f"INSERT INTO {name} (session, position, {column}) VALUES (:number, :position, :blob)",
                    {"number": number, "position": position, "blob": blob},
                )
        for event_id in (1, 2):
            tx.execute(
                "INSERT INTO event (session, id, type, data) VALUES (:number, :id, 'session', :data)",
                {"number": number, "id": event_id, "data": f'{{"n": {event_id}}}'},
            )
        if record is records[0]:
            tx.execute(
                "INSERT INTO idempotency_key (owner, key, fingerprint, session, created) "
                "VALUES ('', :key, :fingerprint, :number, :created)",
                {"key": KEY, "fingerprint": FINGERPRINT, "number": number, "created": record.created},
            )


def migrate_until(moment: int, path: Path) -> bool:
    """Migrates the file in a process that a SIGKILL ends at this moment; False if it had migrated by then.

    The moments are the beginnings of the migration's statements, and some within the long ones.
    """
    child = os.fork()
    if child == 0:
        try:
            db = sqlite._connect(path)
            seen = 0

            def count(*_: object) -> int:
                nonlocal seen
                seen += 1
                if seen > moment:
                    os.kill(os.getpid(), signal.SIGKILL)
                return 0

            db.set_trace_callback(count)
            db.set_progress_handler(count, 50)
            sqlite_migrations.migrate(db, path.parent)
        finally:
            os._exit(0)
    _, status = os.waitpid(child, 0)
    return os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGKILL


def main(old: Path, folder: Path) -> None:
    moment = 0
    while True:
        copy = folder / str(moment)
        copy.mkdir(parents=True)
        for file in old.parent.iterdir():
            shutil.copy(file, copy)
        if not migrate_until(moment, copy / old.name):
            return
        moment += 1


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
