"""The store in a file: one process at a time, private, honest about a disk that cannot be written."""

from __future__ import annotations

import sqlite3
import stat
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.records import a_record
from helpers.stores import same
from pretouch_orchestrator.store.migrations import load_migrations
from pretouch_orchestrator.store.sqlite import FILE_NAME, open_store

from pretouch.camera import DepthImage
from pretouch.errors import Unavailable
from pretouch.scene import Scene


async def test_a_second_orchestrator_is_kept_out(tmp_path: Path) -> None:
    async with open_store(tmp_path):
        with pytest.raises(Unavailable, match="Another orchestrator"):
            async with open_store(tmp_path):
                pass


async def test_leases_do_not_outlive_the_process(tmp_path: Path) -> None:
    async with open_store(tmp_path) as store:
        assert await store.acquire_lease("one", "me", 3600)
    async with open_store(tmp_path) as store:
        assert await store.acquire_lease("one", "you", 3600)


async def test_only_the_owner_of_the_files_may_read_them(tmp_path: Path) -> None:
    folder = tmp_path / "state"
    async with open_store(folder) as store:
        await store.create("", a_record(), [], None)
        assert modes(folder) == {".": 0o700, "lock": 0o600, **dict.fromkeys(database_files(), 0o600)}
    folder.chmod(0o755)
    for file in folder.iterdir():
        file.chmod(0o644)
    async with open_store(folder) as store:
        await store.check()
        assert modes(folder) == {".": 0o700, "lock": 0o600, **dict.fromkeys(database_files(), 0o600)}


def database_files() -> list[str]:
    return [FILE_NAME + end for end in ("", "-wal", "-shm")]


def modes(folder: Path) -> dict[str, int]:
    return {str(file.relative_to(folder)): stat.S_IMODE(file.stat().st_mode) for file in (folder, *folder.iterdir())}


async def test_the_file_shrinks_when_sessions_go(tmp_path: Path) -> None:
    record = a_record()
    depth = np.random.default_rng(0).uniform(0.5, 1.0, (500, 500)).astype(np.float32)
    scene = Scene(DepthImage(depth), record.scene.camera, record.scene.base_T_camera, depth > 0, record.scene.table)
    async with open_store(tmp_path) as store:
        await store.create("", replace(record, scene=scene), [], None)
    full = (tmp_path / FILE_NAME).stat().st_size
    async with open_store(tmp_path) as store:
        await store.remove("", "one")
        await store.tidy()
    assert full > depth.nbytes > 2 * (tmp_path / FILE_NAME).stat().st_size


async def test_a_store_of_a_newer_version_is_refused_untouched(tmp_path: Path) -> None:
    async with open_store(tmp_path):
        pass
    with closing(sqlite3.connect(tmp_path / FILE_NAME)) as db:
        db.execute("PRAGMA user_version = 999")
    with pytest.raises(Unavailable, match="version 999"):
        async with open_store(tmp_path):
            pass
    with closing(sqlite3.connect(tmp_path / FILE_NAME)) as db:
        assert db.execute("PRAGMA user_version").fetchone() == (999,)
    assert len(load_migrations("sqlite")) < 999


async def test_a_file_that_is_no_database_is_refused(tmp_path: Path) -> None:
    (tmp_path / FILE_NAME).write_bytes(b"not a database" * 100)
    with pytest.raises(Unavailable, match="cannot be used"):
        async with open_store(tmp_path):
            pass


async def test_a_disk_that_becomes_read_only_is_unavailable_and_can_be_read(tmp_path: Path) -> None:
    async with open_store(tmp_path) as store:
        record = await store.create("", a_record(), [], None)
        store._database._writer.execute("PRAGMA query_only = ON")  # its error is that of such a disk
        with pytest.raises(Unavailable, match="readonly"):
            await store.check()
        with pytest.raises(Unavailable, match="readonly"):
            await store.acquire_lease("one", "me", 1)
        assert same(await store.load_record("", "one", None), record)
        store._database._writer.execute("PRAGMA query_only = OFF")
        await store.check()


async def test_a_full_disk_is_unavailable_and_passes(tmp_path: Path) -> None:
    async with open_store(tmp_path) as store:
        record = await store.create("", a_record(), [], None)
        database = store._database
        pages = await database.write(lambda tx: tx.execute("PRAGMA page_count"))
        await database.write(lambda tx: tx.execute(f"PRAGMA max_page_count = {pages[0]['page_count']}"))
        with pytest.raises(Unavailable, match="cannot be written"):  # noqa: PT012
            for count in range(100):
                await store.create("", a_record(f"more {count}"), [], None)
        with pytest.raises(Unavailable, match="cannot be written"):
            await store.check()
        await database.write(lambda tx: tx.execute("PRAGMA max_page_count = 1073741823"))
        await store.check()
        await store.create("", a_record("two"), [], None)
        assert same(await store.load_record("", "one", None), record)
