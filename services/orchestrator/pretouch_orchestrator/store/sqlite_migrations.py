"""Brings the tables of a SQLite file to the present schema."""

from __future__ import annotations

import sqlite3
from pathlib import Path

from pretouch_orchestrator.store.migrations import check_version, load_migrations
from pretouch_orchestrator.store.rows import scene_digest, view_ended


def migrate(db: sqlite3.Connection, folder: Path) -> None:
    """Applies what is missing, each script in one transaction with its number, `PRAGMA user_version`.

    Raises:
        Unavailable: a newer pretouch has written the file.
    """
    scripts = load_migrations("sqlite")
    (row,) = db.execute("PRAGMA user_version")
    applied = row["user_version"]
    check_version(applied, len(scripts), str(folder))
    db.create_function("scene_digest", 1, scene_digest, deterministic=True)
    db.create_function("view_ended", 1, view_ended, deterministic=True)
    db.execute("PRAGMA foreign_keys = OFF")  # a table that is replaced is dropped
    for version, script in enumerate(scripts[applied:], start=applied + 1):
        db.executescript(f"BEGIN IMMEDIATE; {script}; PRAGMA user_version = {version}; COMMIT;")
