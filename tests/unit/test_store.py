"""The store returns records to the bit; it migrates any older file and refuses a newer one."""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.records import a_record, after_a_scan, after_telling
from pretouch_orchestrator.store.protocol import Event, KeyedRequest, NewEvent
from pretouch_orchestrator.store.sqlite import FILE_NAME, SqliteStore, load_migrations, open_store

from pretouch.errors import NotFound, Unavailable
from pretouch.v1 import orchestrator_pb2
from pretouch.wire import json


def same(a: Any, b: Any) -> bool:
    """Equal to the bit, through dataclasses, tuples and arrays."""
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    if hasattr(a, "__dataclass_fields__"):
        return type(a) is type(b) and all(same(getattr(a, f), getattr(b, f)) for f in a.__dataclass_fields__)
    if isinstance(a, tuple):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    return bool(a == b)


@pytest.fixture
async def store(tmp_path: Path) -> AsyncIterator[SqliteStore]:
    async with open_store(tmp_path) as opened:
        yield opened


async def test_a_record_comes_back_to_the_bit_from_a_reopened_store(tmp_path: Path) -> None:
    record = a_record()
    async with open_store(tmp_path) as store:
        await store.create(record, [], None)
    async with open_store(tmp_path) as store:
        assert same(await store.load_record("one"), record)
        record = after_a_scan(record)
        await store.update(record, [])
    async with open_store(tmp_path) as store:
        assert same(await store.load_record("one"), record)
        assert json.session_to_json(await store.load_session("one")) == json.session_to_json(record.to_session())


async def test_told_samples_come_back_to_the_bit_until_their_scan_is_closed(tmp_path: Path) -> None:
    record = a_record()
    async with open_store(tmp_path) as store:
        await store.create(record, [], None)
        for count in (3, 1):
            record = after_telling(record, count)
            await store.update(record, [])
    async with open_store(tmp_path) as store:
        assert same(await store.load_record("one"), record)
        record = after_telling(record)
        await store.update(record, [])
        assert same(await store.load_record("one"), record)
        closed = after_a_scan(record)
        await store.update(closed, [])
        assert same(await store.load_record("one"), closed)
        told_anew = after_telling(closed, 2)
        await store.update(told_anew, [])
        assert same(await store.load_record("one"), told_anew)


async def test_a_session_from_before_modes_and_fit_reads_as_one_with_a_single_mode_that_fits(tmp_path: Path) -> None:
    record = a_record()
    async with open_store(tmp_path) as store:
        await store.create(record, [], None)
    with contextlib.closing(sqlite3.connect(tmp_path / FILE_NAME)) as db:
        ((view,),) = db.execute("SELECT view FROM session")
        message = orchestrator_pb2.Session.FromString(view)
        for name in ("modes", "fit", "sensor_problem"):
            message.estimate.ClearField(name)
        message.estimate.MergeFromString(b"\x50\x01")  # several_modes = true, which was field 10
        db.execute("UPDATE session SET view = ?", (message.SerializeToString(),))
        db.commit()
    async with open_store(tmp_path) as store:
        estimate = (await store.load_record("one")).estimate
        assert (await store.load_session("one")).reason is None
    assert [mode.weight for mode in estimate.modes] == [1.0]
    assert same(estimate.modes[0].base_T_correction, record.estimate.base_T_correction)
    assert (estimate.fit, estimate.sensor_problem) == (1.0, "")
    assert estimate.expected_error == record.estimate.expected_error


async def test_events_are_numbered_within_their_session(store: SqliteStore) -> None:
    await store.create(a_record("one"), [NewEvent("session", {"n": 1}), NewEvent("estimate", {"n": 2})], None)
    await store.create(a_record("two"), [NewEvent("session", {"n": 3})], None)
    await store.update(after_a_scan(a_record("one")), [NewEvent("end", {"state": "failed"})])
    assert await store.load_events("one", after=1) == [
        Event("estimate", {"n": 2}, 2),
        Event("end", {"state": "failed"}, 3),
    ]
    assert [event.id for event in await store.load_events("two", after=0)] == [1]


async def test_a_step_that_fails_leaves_nothing_behind(store: SqliteStore) -> None:
    record = a_record()
    await store.create(record, [NewEvent("session", {})], None)
    with pytest.raises(TypeError):
        await store.update(after_a_scan(record), [NewEvent("scan", {}), NewEvent("end", {"not JSON": object()})])
    assert same(await store.load_record("one"), record)
    assert len(await store.load_events("one", after=0)) == 1


async def test_an_idempotency_key_leads_to_one_session(store: SqliteStore) -> None:
    key = KeyedRequest("k", "abc")
    await store.create(a_record("one"), [], key)
    assert await store.find_keyed("k") == (key, "one")
    assert await store.find_keyed("other") is None
    with pytest.raises(sqlite3.IntegrityError):
        await store.create(a_record("two"), [], key)
    with pytest.raises(NotFound):
        await store.load_session("two")


async def test_pages_go_from_the_newest_to_the_oldest(store: SqliteStore) -> None:
    for name in "abcde":
        await store.create(a_record(name), [], None)
    seen, before = [], None
    while True:
        sessions, before = await store.list_sessions(2, before)
        seen.append([session.id for session in sessions])
        if before is None:
            break
    assert seen == [["e", "d"], ["c", "b"], ["a"]]


async def test_unknown_sessions_are_not_found(store: SqliteStore) -> None:
    for call in (
        store.load_record("x"),
        store.load_session("x"),
        store.load_events("x", 0),
        store.update(a_record("x"), []),
    ):
        with pytest.raises(NotFound):
            await call


async def test_a_second_orchestrator_is_kept_out(store: SqliteStore, tmp_path: Path) -> None:
    with pytest.raises(Unavailable, match="Another orchestrator"):
        async with open_store(tmp_path):
            pass


async def test_migrations_apply_one_by_one_to_the_same_tables(tmp_path: Path) -> None:
    async with open_store(tmp_path / "new"):
        pass
    (tmp_path / "old").mkdir()
    with sqlite3.connect(tmp_path / "old" / FILE_NAME) as old:
        old.executescript(f"{load_migrations()[0]}; PRAGMA user_version = 1")
    old.close()
    async with open_store(tmp_path / "old") as store:
        await store.create(a_record(), [], None)
    schemas = []
    for name in ("new", "old"):
        db = sqlite3.connect(tmp_path / name / FILE_NAME)
        schemas.append(db.execute("SELECT type, name, sql FROM sqlite_master ORDER BY name").fetchall())
        assert db.execute("PRAGMA user_version").fetchone() == (len(load_migrations()),)
        assert db.execute("PRAGMA journal_mode").fetchone() == ("wal",)
        db.close()
    assert schemas[0] == schemas[1]


async def test_a_store_of_a_newer_version_is_refused_untouched(tmp_path: Path) -> None:
    async with open_store(tmp_path):
        pass
    with sqlite3.connect(tmp_path / FILE_NAME) as db:
        db.execute("PRAGMA user_version = 999")
    db.close()
    with pytest.raises(Unavailable, match="version 999"):
        async with open_store(tmp_path):
            pass


async def test_a_file_that_is_no_database_is_refused(tmp_path: Path) -> None:
    (tmp_path / FILE_NAME).write_bytes(b"not a database" * 100)
    with pytest.raises(Unavailable, match="cannot be used"):
        async with open_store(tmp_path):
            pass


async def test_a_full_disk_is_unavailable_and_passes(store: SqliteStore, tmp_path: Path) -> None:
    record = a_record()
    await store.create(record, [], None)
    pages = await store._writer.execute_fetchall("PRAGMA page_count")
    await store._writer.execute_fetchall(f"PRAGMA max_page_count = {next(iter(pages))[0]}")
    with pytest.raises(Unavailable, match="cannot be written"):
        await store.create(a_record("two"), [], None)
    await store._writer.execute_fetchall("PRAGMA max_page_count = 1073741823")
    await store.create(a_record("two"), [], None)
    assert same(await store.load_record("one"), record)
