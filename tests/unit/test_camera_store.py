"""What every kind of store promises of cameras: each end of a session counts once, with it or not at all."""

from __future__ import annotations

import asyncio
import signal
import sqlite3
import subprocess
import sys
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, closing
from pathlib import Path

import pytest
from helpers.camera_ends import camera_record, converged, counted, left_out
from helpers.stores import same
from pretouch_orchestrator.sessions.endings import cancel
from pretouch_orchestrator.store import camera_sql, open_store
from pretouch_orchestrator.store.protocol import (
    CameraChanged,
    CameraMemory,
    CameraUpdate,
    NewEvent,
    Stale,
    Store,
)

from pretouch.errors import NotFound
from pretouch.session import State

TESTS = Path(__file__).parents[1]


@pytest.fixture
async def store(store_address: str) -> AsyncIterator[Store]:
    async with open_store(store_address) as opened:
        yield opened


async def end(store: Store, session_id: str, update: CameraUpdate, owner: str = "", camera: str = "head") -> None:
    """Opens a session and ends it."""
    record = await store.create(owner, camera_record(session_id, camera), [], None)
    await store.update(record, converged(record), [NewEvent("session", {})], None, update)


async def remembered(store: Store, owner: str = "", camera: str = "head") -> CameraMemory:
    memory = await store.load_camera(owner, camera)
    assert memory is not None
    return memory


async def test_what_a_session_found_comes_back_to_the_bit_and_outlives_it(store_address: str) -> None:
    async with open_store(store_address) as store:
        assert await store.load_camera("", "head") is None
        await end(store, "one", counted("one", 0))
        await end(store, "two", left_out("two", "It failed."))
        await store.remove("", "one")
    async with open_store(store_address) as store:
        memory = await remembered(store)
        assert same(memory.counted, (counted("one", 0).entry,))
        assert same(memory.left_out, (left_out("two", "It failed.").entry,))
        assert same(memory.base_T_camera, camera_record("one").request.base_T_camera)
        assert memory.summary.sessions == 1
        assert (await store.list_cameras(""))[0].sessions == 1


async def test_a_camera_is_remembered_from_the_first_session_that_names_it(store: Store) -> None:
    await store.create("", camera_record("one"), [], None)
    memory = await remembered(store)
    assert (memory.summary.sessions, memory.counted, memory.left_out) == (0, (), ())
    assert memory.summary.drift.state == "steady"


async def test_owners_and_cameras_are_separate(store: Store) -> None:
    for owner, camera in (("ann", "head"), ("bob", "head"), ("ann", "wrist")):
        await end(store, f"{owner}-{camera}", counted(f"{owner}-{camera}", 0), owner, camera)
    for owner, cameras in (("ann", ["head", "wrist"]), ("bob", ["head"]), ("", [])):
        assert [camera.id for camera in await store.list_cameras(owner)] == cameras
    assert [entry.session_id for entry in (await remembered(store, "bob")).counted] == ["bob-head"]
    await store.forget_camera("ann", "head")
    assert await store.load_camera("ann", "head") is None
    assert (await remembered(store, "bob")).summary.sessions == 1
    for owner, camera in (("ann", "head"), ("", "wrist"), ("bob", "wrist"), ("bob", "\0"), ("bob", "")):
        assert await store.load_camera(owner, camera) is None
        with pytest.raises(NotFound):
            await store.forget_camera(owner, camera)


async def test_an_end_that_was_computed_without_another_ones_is_computed_again(store: Store) -> None:
    await end(store, "one", counted("one", 0))
    record = await store.create("", camera_record("two"), [NewEvent("session", {})], None)
    with pytest.raises(CameraChanged):
        await store.update(record, converged(record), [NewEvent("end", {})], None, counted("two", 0))
    assert same(await store.load_record("", "two", None), record), "nothing of the step was stored"
    assert len(await store.load_events("two", 0)) == 1
    last = (await remembered(store)).last
    after = await store.update(
        record, converged(record), [NewEvent("end", {})], None, counted("two", last, 1.0, "moved")
    )
    with pytest.raises(Stale):
        await store.update(record, converged(record), [NewEvent("session", {})], None, counted("two", last))
    memory = await remembered(store)
    assert [entry.session_id for entry in memory.counted] == ["one", "two"], "the order of ends, whatever the clock"
    assert (memory.summary.drift.state, memory.summary.drift.since) == ("moved", "two")
    assert memory.last > last
    assert after.version == 2


async def test_cancelled_sessions_do_not_count_and_those_of_no_camera_leave_nothing(store: Store) -> None:
    await store.create("", camera_record("one"), [], None)
    await store.create("", camera_record("two", "wrist"), [], None)
    for session_id in ("one", "two"):
        before = await store.load_session("", session_id)
        if session_id == "two":
            await store.forget_camera("", "wrist")
        await store.end(before, cancel(before.session), [])
    memory = await remembered(store)
    assert [(entry.session_id, entry.reason) for entry in memory.left_out] == [("one", camera_sql.CANCELLED)]
    assert await store.load_camera("", "wrist") is None


async def test_a_session_of_a_forgotten_camera_ends_and_teaches_nothing(store: Store) -> None:
    record = await store.create("", camera_record("one"), [], None)
    await store.forget_camera("", "head")
    await store.update(record, converged(record), [NewEvent("session", {})], None, counted("one", 0))
    assert (await store.load_session("", "one")).session.state is State.CONVERGED
    assert await store.load_camera("", "head") is None


async def test_what_is_kept_is_bounded(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(camera_sql, "MAX_COUNTED", 3)
    monkeypatch.setattr(camera_sql, "MAX_LEFT_OUT", 2)
    monkeypatch.setattr(camera_sql, "MAX_CAMERAS", 2)
    for number in range(5):
        last = 0 if number == 0 else (await remembered(store)).last
        await end(store, f"c{number}", counted(f"c{number}", last))
        await end(store, f"f{number}", left_out(f"f{number}"))
    memory = await remembered(store)
    assert [entry.session_id for entry in memory.counted] == ["c2", "c3", "c4"]
    assert [entry.session_id for entry in memory.left_out] == ["f3", "f4"], "failures push out no session that counts"
    assert memory.summary.sessions == 5
    for camera in ("wrist", "shelf"):
        await end(store, camera, counted(camera, 0), camera=camera)
    assert [camera.id for camera in await store.list_cameras("")] == ["head", "wrist"]
    await end(store, "more", counted("more", memory.last))
    assert (await remembered(store)).summary.sessions == 6, "those that are known are learned on"


async def test_of_many_ends_at_once_none_is_lost_or_doubled(store_address: str) -> None:
    async with AsyncExitStack() as stack:
        stores = [await stack.enter_async_context(open_store(store_address))]
        if store_address.startswith("postgresql"):
            stores.append(await stack.enter_async_context(open_store(store_address)))

        async def run(number: int) -> None:
            store = stores[number % len(stores)]
            record = await store.create("", camera_record(f"s{number}"), [], None)
            while True:
                last = (await remembered(store)).last
                try:
                    await store.update(
                        record, converged(record), [NewEvent("session", {})], None, counted(f"s{number}", last)
                    )
                    return
                except CameraChanged:
                    continue

        await asyncio.gather(*(run(number) for number in range(16)))
        memory = await remembered(stores[-1])
        assert sorted(entry.session_id for entry in memory.counted) == sorted(f"s{number}" for number in range(16))
        assert memory.summary.sessions == 16


_KILLED = """
import asyncio, os, signal, sys
from helpers.camera_ends import camera_record, converged, counted
from pretouch_orchestrator.store import camera_sql, open_store

async def main():
    async with open_store("sqlite:" + sys.argv[1]) as store:
        record = await store.create("", camera_record("one"), [], None)
        stored = camera_sql.store_entry
        def store_and_die(*args):
            stored(*args)
            os.kill(os.getpid(), signal.SIGKILL)
        camera_sql.store_entry = store_and_die
        await store.update(record, converged(record), [], None, counted("one", 0))

asyncio.run(main())
"""


async def test_a_process_that_is_killed_while_a_session_ends_leaves_both_or_neither(tmp_path: Path) -> None:
    command = [sys.executable, "-c", _KILLED, str(tmp_path)]
    killed = await asyncio.to_thread(subprocess.run, command, cwd=TESTS, timeout=240)
    assert killed.returncode == -signal.SIGKILL
    async with open_store(f"sqlite:{tmp_path}") as store:
        record = await store.load_record("", "one", None)
        assert record.state is State.AWAITING_SCAN
        assert (await remembered(store)).counted == ()
        await store.update(record, converged(record), [NewEvent("session", {})], None, counted("one", 0))
        assert [entry.session_id for entry in (await remembered(store)).counted] == ["one"]
    with closing(sqlite3.connect(tmp_path / "sessions.sqlite")) as db:
        assert db.execute("PRAGMA foreign_key_check").fetchall() == []
