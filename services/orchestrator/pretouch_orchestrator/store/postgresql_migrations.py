"""Brings the tables of a PostgreSQL database to the present schema."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import psycopg

from pretouch_orchestrator.store.migrations import check_version, load_migrations

_LOCK = 0x7072_6574_6F75_6368
"""Key of the advisory lock under which one process at a time migrates: "pretouch" in ASCII."""


def migrate(address: str, options: Mapping[str, Any]) -> None:
    """Applies what is missing, each script in one transaction with its number.

    Raises:
        Unavailable: a newer pretouch has written the tables.
        psycopg.Error: the database cannot be used.
    """
    scripts = load_migrations("postgresql")
    with psycopg.connect(address, autocommit=True, **options) as connection:
        connection.execute("SELECT pg_advisory_lock(%s)", (_LOCK,))
        connection.execute("CREATE TABLE IF NOT EXISTS schema_version (version BIGINT PRIMARY KEY)")
        ((applied,),) = connection.execute("SELECT coalesce(max(version), 0) FROM schema_version").fetchall()
        check_version(applied, len(scripts), connection.info.dbname)
        for version, script in enumerate(scripts[applied:], start=applied + 1):
            with connection.transaction():
                connection.execute(script.encode())
                connection.execute("INSERT INTO schema_version (version) VALUES (%s)", (version,))
