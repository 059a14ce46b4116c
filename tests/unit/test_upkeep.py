"""Sessions go after a time, and earlier where there is no more room; what is still needed stays."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from dataclasses import replace
from typing import Any

import pytest
import structlog
from helpers.records import a_record, after_a_scan
from pretouch_orchestrator.sessions.upkeep import Limits, Upkeep
from pretouch_orchestrator.settings import OrchestratorSettings
from pretouch_orchestrator.store import open_store, sql
from pretouch_orchestrator.store.protocol import KeyedRequest, NewEvent, Store

from pretouch.errors import InvalidInput, Unavailable


@pytest.fixture
async def store(store_address: str) -> AsyncIterator[Store]:
    async with open_store(store_address) as opened:
        yield opened


async def ended(store: Store, name: str, owner: str = "") -> None:
    record = await store.create(owner, a_record(name), [], None)
    await store.update(record, after_a_scan(record), [NewEvent("end", {})], None)


async def names(store: Store, owner: str = "") -> list[str]:
    return [session.id for session in (await store.list_sessions(owner, 100, None))[0]]


def upkeep(store: Store, **limits: Any) -> Upkeep:
    return Upkeep(store, replace(Limits(3600.0, 2**30), **limits), structlog.get_logger())


async def test_sessions_go_when_they_are_past_keeping_and_abandoned_ones_end_first(store: Store) -> None:
    await ended(store, "ended", "ann")
    await store.create("", a_record("abandoned"), [NewEvent("session", {})], None)
    following = store.changes.expect("abandoned")
    await upkeep(store).sweep()
    assert [*await names(store), *await names(store, "ann")] == ["abandoned", "ended"]
    await upkeep(store, keep=0.0).sweep()
    assert [*await names(store), *await names(store, "ann")] == []
    assert following.is_set()
    assert await store.used_bytes() == 0


async def test_the_longest_ended_go_first_where_there_is_no_more_room(store: Store) -> None:
    for name in ("a", "b", "c"):
        await ended(store, name)
    await store.create("", a_record("open"), [], None)
    used = await store.used_bytes()
    await upkeep(store, max_bytes=used + 1).make_room()
    assert await names(store) == ["open", "c", "b", "a"]
    await upkeep(store, max_bytes=used).make_room()
    assert await names(store) == ["open", "c", "b"]
    with pytest.raises(Unavailable, match="no session in it has ended") as refusal:
        await upkeep(store, max_bytes=1).make_room()
    assert refusal.value.retry_after == 30.0
    assert await names(store) == ["open"]


async def test_two_processes_may_sweep_at_once(store: Store) -> None:
    for count in range(25):
        await ended(store, f"ended {count}")
        await store.create("", a_record(f"open {count}"), [], None)
    await asyncio.gather(*(upkeep(store, keep=0.0).sweep() for _ in range(3)))
    assert await names(store) == []
    assert await store.used_bytes() == 0


async def test_keys_are_forgotten_after_a_day(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    key = KeyedRequest("k", "abc")
    await store.create("", a_record("one"), [], key)
    await store.tidy()
    assert await store.find_keyed("", "k") == (key, "one")
    monkeypatch.setattr(sql, "KEY_LIFETIME", -1.0)
    assert await store.find_keyed("", "k") is None
    again = KeyedRequest("k", "another request")
    await store.create("", a_record("two"), [], again)
    await store.tidy()
    monkeypatch.undo()
    assert await store.find_keyed("", "k") is None
    assert await names(store) == ["two", "one"]


@pytest.mark.parametrize(
    ("variables", "keep", "max_bytes"),
    [
        ({}, 30 * 86400.0, 10 * 2**30),
        ({"KEEP": "7", "MAX_STORE": "1048576"}, 7 * 86400.0, 2**20),
        ({"KEEP": "1.5h", "MAX_STORE": "2 TiB"}, 5400.0, 2**41),
        ({"KEEP": "90min", "MAX_STORE": "0.5MiB"}, 5400.0, 2**19),
    ],
)
def test_limits_are_read_with_their_units(variables: dict[str, str], keep: float, max_bytes: int) -> None:
    assert read(variables) == (keep, max_bytes)


@pytest.mark.parametrize("name", ["KEEP", "MAX_STORE"])
@pytest.mark.parametrize("text", ["0", "-1", "1e9", "forever", "10 GX", "nan", "٣d", "1" * 40])
def test_limits_that_cannot_be_read_are_named(name: str, text: str) -> None:
    with pytest.raises(InvalidInput, match=f"PRETOUCH_ORCHESTRATOR_{name} is"):
        read({name: text})


def read(variables: dict[str, str]) -> tuple[float, int]:
    needed = {"DETECTOR": "d:1", "REGISTRAR": "r:1", "STATE": "s"}
    settings = OrchestratorSettings.from_environment(
        {f"PRETOUCH_ORCHESTRATOR_{name}": value for name, value in (needed | variables).items()}
    )
    return settings.keep, settings.max_store
