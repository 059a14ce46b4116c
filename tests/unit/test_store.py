"""What every kind of store promises: records come back to the bit, versions fence updates, leases exclude."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from dataclasses import replace
from typing import Any

import pytest
from helpers.records import a_record, after_a_scan, after_telling
from helpers.stores import same
from pretouch_orchestrator.sessions.endings import cancel
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.store import open_store
from pretouch_orchestrator.store.protocol import Busy, Event, KeyedRequest, NewEvent, Owned, Snapshot, Stale, Store

from pretouch.errors import NotFound
from pretouch.session import State
from pretouch.wire import common, json


@pytest.fixture
async def store(store_address: str) -> AsyncIterator[Store]:
    async with open_store(store_address) as opened:
        yield opened


async def created(store: Store, session_id: str = "one", owner: str = "") -> Record:
    return await store.create(owner, a_record(session_id), [NewEvent("session", {"n": 1})], None)


async def stepped(store: Store, before: Record, after: Record, lease: str | None = None) -> Record:
    return await store.update(before, after, [NewEvent("session", {"n": 2})], lease)


async def test_a_record_comes_back_to_the_bit_from_a_reopened_store(store_address: str) -> None:
    async with open_store(store_address) as store:
        record = await created(store)
    async with open_store(store_address) as store:
        assert same(await store.load_record("", "one", None), record)
        record = await stepped(store, record, after_a_scan(record))
    async with open_store(store_address) as store:
        assert same(await store.load_record("", "one", None), record)
        seen = (await store.load_session("", "one")).session
        assert json.session_to_json(seen) == json.session_to_json(record.to_session())


async def test_told_samples_come_back_to_the_bit_until_their_scan_is_closed(store: Store) -> None:
    first = record = await created(store)
    for count in (3, 1):
        record = await store.update(record, after_telling(record, count), [], None)
        assert same(await store.load_record("", "one", None), record)
        assert same(await store.load_record("", "one", first), record), "only what is new is read"
    closed = await stepped(store, record, after_a_scan(record))
    for known in (None, first, record):
        assert same(await store.load_record("", "one", known), closed)
    anew = await store.update(closed, after_telling(closed, 2), [], None)
    assert same(await store.load_record("", "one", None), anew)


async def test_a_record_that_is_still_present_is_not_read_again(store: Store) -> None:
    record = await created(store)
    assert await store.load_record("", "one", record) is record
    assert await store.is_present(record)
    later = await stepped(store, record, after_a_scan(record))
    assert not await store.is_present(record)
    loaded = await store.load_record("", "one", record)
    assert loaded.scene is record.scene, "the scene is not read again"
    assert same(loaded, later)
    from_the_future = replace(record, version=99)
    assert same(await store.load_record("", "one", from_the_future), later), "as after restoring a backup"


async def test_an_update_of_an_outdated_record_is_refused_and_leaves_nothing(store: Store) -> None:
    record = await created(store)
    later = await store.update(record, after_telling(record), [], None)
    for update in (
        stepped(store, record, after_a_scan(record)),
        store.update(record, after_telling(record, 1), [], None),
        store.end(Snapshot(record.to_session(), record.version, 1), cancel(record.to_session()), [NewEvent("end", {})]),
    ):
        with pytest.raises(Stale):
            await update
    assert same(await store.load_record("", "one", None), later)
    assert len(await store.load_events("one", 0)) == 1


async def test_of_updates_at_once_one_counts(store: Store) -> None:
    record = await created(store)
    updates = [stepped(store, record, after_a_scan(record)) for _ in range(6)]
    outcomes = await asyncio.gather(*updates, return_exceptions=True)
    assert sorted(type(outcome).__name__ for outcome in outcomes) == ["Record", *["Stale"] * 5]
    assert [event.id for event in await store.load_events("one", 0)] == [1, 2]


async def test_an_end_does_not_wait_for_a_lease(store: Store) -> None:
    record = await store.update(await created(store), after_telling(await store.load_record("", "one", None)), [], None)
    assert await store.acquire_lease("one", "me", 60)
    before = await store.load_session("", "one")
    await store.end(before, cancel(before.session), [NewEvent("end", {"state": "cancelled"})])
    ended = await store.load_record("", "one", record)
    assert (ended.state, ended.next_scan, ended.told) == (State.CANCELLED, None, ())
    assert same(await store.load_record("", "one", None), ended)
    with pytest.raises(Stale):
        await stepped(store, record, after_a_scan(record), "me")


async def test_a_lease_has_one_holder_until_it_ends_or_runs_out(store: Store) -> None:
    assert await store.acquire_lease("key k", "me", 60)
    assert await store.acquire_lease("key k", "me", 60), "as after an answer that was lost"
    assert not await store.acquire_lease("key k", "you", 60)
    await store.release_lease("key k", "you")
    assert not await store.acquire_lease("key k", "you", 60)
    await store.release_lease("key k", "me")
    assert await store.acquire_lease("key k", "you", -1)
    assert await store.acquire_lease("key k", "me", -1), "it had run out"
    await store.renew_leases(["me"], 60)
    assert not await store.acquire_lease("key k", "you", 60)


async def test_samples_are_not_taken_while_a_step_holds_the_lease_which_ends_with_the_step(store: Store) -> None:
    record = await created(store)
    assert await store.acquire_lease("one", "me", 60)
    with pytest.raises(Busy):
        await store.update(record, after_telling(record), [], None)
    record = await stepped(store, record, after_a_scan(record), "me")
    assert await store.acquire_lease("one", "you", 60)


async def test_events_are_numbered_within_their_session(store: Store) -> None:
    await store.create("", a_record("one"), [NewEvent("session", {"n": 1}), NewEvent("estimate", {"n": 2})], None)
    await store.create("", a_record("two"), [NewEvent("session", {"n": 3})], None)
    one = await store.load_record("", "one", None)
    await store.update(one, after_a_scan(one), [NewEvent("end", {"state": "failed"})], None)
    assert await store.load_events("one", after=1) == [
        Event("estimate", {"n": 2}, 2),
        Event("end", {"state": "failed"}, 3),
    ]
    assert [event.id for event in await store.load_events("two", after=0)] == [1]


async def test_a_step_that_fails_leaves_nothing_behind(store: Store) -> None:
    record = await created(store)
    with pytest.raises(TypeError):
        await store.update(record, after_a_scan(record), [NewEvent("end", {"not JSON": object()})], None)
    assert same(await store.load_record("", "one", None), record)


async def test_an_idempotency_key_leads_to_one_session_of_its_owner(store: Store) -> None:
    key = KeyedRequest("k", "abc")
    await store.create("ann", a_record("one"), [], key)
    assert await store.find_keyed("ann", "k") == (key, "one")
    assert await store.find_keyed("ann", "other") is None
    assert await store.find_keyed("bob", "k") is None
    with pytest.raises(Stale):
        await store.create("ann", a_record("two"), [], key)
    with pytest.raises(NotFound):
        await store.load_session("ann", "two")
    await store.create("bob", a_record("three"), [], key)
    assert await store.find_keyed("bob", "k") == (key, "three")


async def test_pages_go_from_the_newest_to_the_oldest_of_one_owner(store: Store) -> None:
    for name in "abcde":
        await created(store, name, "ann")
        await created(store, name * 2, "bob")
    seen, before = [], None
    while True:
        sessions, before = await store.list_sessions("ann", 2, before)
        seen.append([session.id for session in sessions])
        if before is None:
            break
    assert seen == [["e", "d"], ["c", "b"], ["a"]]


async def test_sessions_that_are_unknown_or_of_another_owner_are_not_found(store: Store) -> None:
    await created(store, "hers", "ann")
    unknown = await created(store, "x")
    await store.remove("", "x")
    for name in ("x", "hers", "null\0", "\ud800", "é"):
        for call in (store.load_record("", name, None), store.load_session("", name)):
            with pytest.raises(NotFound):
                await call
    for change in (store.load_events("x", 0), store.update(unknown, after_a_scan(unknown), [], None)):
        with pytest.raises(NotFound):
            await change
    await store.remove("", "hers")
    assert (await store.load_session("ann", "hers")).version == 1


async def test_a_scene_is_stored_once_and_goes_with_its_last_session(store: Store) -> None:
    await created(store, "one")
    with_one = await store.used_bytes()
    await created(store, "two")
    size = common.scene_to_proto(a_record().scene).ByteSize()
    assert with_one > size > await store.used_bytes() - with_one > 0
    await store.remove("", "one")
    assert same((await store.load_record("", "two", None)).scene, a_record().scene)
    await store.remove("", "two")
    assert await store.used_bytes() == 0
    await created(store, "one")


async def test_the_longest_untouched_are_found_first(store: Store) -> None:
    records = {name: await created(store, name, f"of {name}") for name in ("a", "b", "c")}
    for name in ("b", "a"):
        await stepped(store, records[name], after_a_scan(records[name]))
    assert await store.find_ended(9, None) == [Owned("of b", "b"), Owned("of a", "a")]
    assert await store.find_ended(1, 0.0) == [Owned("of b", "b")]
    assert await store.find_ended(9, 1000.0) == []
    assert await store.find_abandoned(9, 0.0) == [Owned("of c", "c")]
    assert await store.find_abandoned(9, 1000.0) == []


async def test_a_check_and_tidying_leave_sessions_alone(store: Store) -> None:
    record = await created(store)
    await store.check()
    await store.tidy()
    assert same(await store.load_record("", "one", None), record)


async def test_changes_are_announced_to_every_process(store_address: str, store: Store) -> None:
    async with AsyncExitStack() as stack:
        other = store
        if store_address.startswith("postgresql"):
            other = await stack.enter_async_context(open_store(store_address))
        record = await created(store)

        async def heard(change: Any) -> Any:
            expected = other.changes.expect("one")
            result = await change
            async with asyncio.timeout(60):
                await expected.wait()
            return result

        record = await heard(store.update(record, after_telling(record), [], None))
        assert await store.acquire_lease("one", "me", 60)
        await heard(store.release_lease("one", "me"))
        await heard(store.end(Snapshot(record.to_session(), record.version, 1), cancel(record.to_session()), []))
        await heard(store.remove("", "one"))
