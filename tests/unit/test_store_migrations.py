"""A session file of any earlier version is migrated without loss, even by a process that is killed at any moment."""

from __future__ import annotations

import asyncio
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
from helpers.camera_ends import camera_record, converged, counted
from helpers.old_store import FINGERPRINT, KEY, write_old_postgresql, write_old_store
from helpers.postgresql import PostgresqlServer
from helpers.records import a_record, after_a_scan, after_telling
from helpers.stores import same
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.store import open_store
from pretouch_orchestrator.store.migrations import load_migrations
from pretouch_orchestrator.store.protocol import Event, KeyedRequest, NewEvent, Owned, Store
from pretouch_orchestrator.store.sqlite import FILE_NAME

from pretouch.v1 import orchestrator_pb2

TESTS = Path(__file__).parents[1]


def old_records(version: int) -> list[Record]:
    """One that has ended, one in a scan (from version 2 on), one of another scene; each of today."""
    other = a_record("three")
    elsewhere = replace(other, scene=replace(other.scene, table=replace(other.scene.table, offset=0.25)))
    second = after_telling(a_record("two")) if version > 1 else a_record("two")
    return [replace(each, created=time.time()) for each in (after_a_scan(a_record("one")), second, elsewhere)]


async def check_migrated(address: str, records: list[Record]) -> None:
    async with open_store(address) as store:
        for record in records:
            loaded = await store.load_record("", record.id, None)
            assert same(loaded, replace(record, version=1))
            assert await store.load_events(record.id, 0) == [Event("session", {"n": n}, n) for n in (1, 2)]
        assert await store.find_keyed("", KEY) == (KeyedRequest(KEY, FINGERPRINT), "one")
        assert await store.find_ended(9, None) == [Owned("", "one")]
        assert [session.id for session in (await store.list_sessions("", 9, None))[0]] == ["three", "two", "one"]
        two = await store.load_record("", "two", None)
        await store.update(two, after_a_scan(two), [NewEvent("session", {"n": 3})], None)
        assert (await store.load_events("two", 2)) == [Event("session", {"n": 3}, 3)]
        for record in records:
            await store.remove("", record.id)
        assert await store.used_bytes() == 0
        await check_cameras(store)


async def check_cameras(store: Store) -> None:
    """Sessions of a migrated store teach their cameras."""
    assert await store.list_cameras("") == []
    record = await store.create("", camera_record("new"), [], None)
    await store.update(record, converged(record), [NewEvent("end", {})], None, counted("new", 0))
    memory = await store.load_camera("", "head")
    assert memory is not None
    assert [entry.session_id for entry in memory.counted] == ["new"]


@pytest.mark.parametrize("version", [1, 2, 3])
async def test_a_file_of_any_earlier_version_is_migrated_without_loss(version: int, tmp_path: Path) -> None:
    records = old_records(version)
    write_old_store(tmp_path / "old" / FILE_NAME, version, records)
    await check_migrated(f"sqlite:{tmp_path / 'old'}", records)
    with closing(sqlite3.connect(tmp_path / "old" / FILE_NAME)) as db:
        assert db.execute("PRAGMA auto_vacuum").fetchone() == (2,), "incremental: it can shrink"


async def test_a_database_of_the_earlier_version_is_migrated_without_loss(postgresql: PostgresqlServer) -> None:
    records, address = old_records(3), postgresql.new_database()
    write_old_postgresql(address, records)
    await check_migrated(address, records)


async def test_a_migration_that_is_killed_at_any_moment_loses_nothing(tmp_path: Path) -> None:
    records = old_records(2)
    write_old_store(tmp_path / "old" / FILE_NAME, 2, records)
    command = [sys.executable, "-m", "helpers.old_store", str(tmp_path / "old" / FILE_NAME), str(tmp_path / "killed")]
    await asyncio.to_thread(subprocess.run, command, cwd=TESTS, check=True, timeout=240)
    copies = sorted((tmp_path / "killed").iterdir(), key=lambda copy: int(copy.name))
    versions = []
    for copy in copies:
        with closing(sqlite3.connect(copy / FILE_NAME)) as db:
            versions.extend(db.execute("PRAGMA user_version").fetchone())
        await check_migrated(f"sqlite:{copy}", records)
    assert versions[0] == 2
    assert versions[-1] == len(load_migrations("sqlite"))
    assert versions.count(2) > 30


async def test_migrations_apply_one_by_one_to_the_same_tables(tmp_path: Path) -> None:
    async with open_store(f"sqlite:{tmp_path / 'new'}"):
        pass
    write_old_store(tmp_path / "old" / FILE_NAME, 1, [a_record()])
    async with open_store(f"sqlite:{tmp_path / 'old'}"):
        pass
    schemas = []
    for name in ("new", "old"):
        with closing(sqlite3.connect(tmp_path / name / FILE_NAME)) as db:
            schemas.append(db.execute("SELECT type, name, sql FROM sqlite_master ORDER BY name").fetchall())
            assert db.execute("PRAGMA user_version").fetchone() == (len(load_migrations("sqlite")),)
            assert db.execute("PRAGMA journal_mode").fetchone() == ("wal",)
            assert db.execute("PRAGMA foreign_key_check").fetchall() == []
    assert schemas[0] == schemas[1]


async def test_a_session_from_before_modes_and_fit_reads_as_one_with_a_single_mode_that_fits(tmp_path: Path) -> None:
    record = a_record()
    async with open_store(f"sqlite:{tmp_path}") as store:
        await store.create("", record, [], None)
    with closing(sqlite3.connect(tmp_path / FILE_NAME)) as db, db:
        ((view,),) = db.execute("SELECT message FROM view")
        message = orchestrator_pb2.Session.FromString(view)
        for name in ("modes", "fit", "sensor_problem"):
            message.estimate.ClearField(name)
        message.estimate.MergeFromString(b"\x50\x01")  # several_modes = true, which was field 10
        db.execute("UPDATE view SET message = ?", (message.SerializeToString(),))
    async with open_store(f"sqlite:{tmp_path}") as store:
        estimate = (await store.load_record("", "one", None)).estimate
        assert (await store.load_session("", "one")).session.reason is None
    assert [mode.weight for mode in estimate.modes] == [1.0]
    assert same(estimate.modes[0].base_T_correction, record.estimate.base_T_correction)
    assert (estimate.fit, estimate.sensor_problem) == (1.0, "")
    assert estimate.expected_error == record.estimate.expected_error
