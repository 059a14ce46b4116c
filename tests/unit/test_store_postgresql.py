"""The store in PostgreSQL: connections that are lost cost a moment, and nothing is told twice or not at all."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator

import psycopg
import pytest
from helpers.postgresql import PostgresqlServer
from helpers.records import a_record, after_telling
from helpers.stores import same
from pretouch_orchestrator.store import open_store
from pretouch_orchestrator.store import postgresql as postgresql_store
from pretouch_orchestrator.store.protocol import Store

from pretouch.errors import Unavailable


@pytest.fixture
def address(postgresql: PostgresqlServer) -> str:
    return postgresql.new_database()


@pytest.fixture
async def stores(address: str) -> AsyncIterator[tuple[Store, Store]]:
    """Those of two processes, which open it at once while it is empty."""
    async with contextlib.AsyncExitStack() as stack:
        opening = (stack.enter_async_context(open_store(address)) for _ in range(2))
        one, two = await asyncio.gather(*opening)
        yield one, two


def execute(address: str, statement: str) -> None:
    with contextlib.closing(psycopg.connect(address, autocommit=True)) as connection:
        connection.execute(statement.encode())


def end_connections(address: str, which: str = "true") -> None:
    execute(
        address,
        "SELECT pg_terminate_backend(pid) FROM pg_stat_activity "
        f"WHERE datname = current_database() AND pid <> pg_backend_pid() AND {which}",
    )


async def test_lost_connections_cost_no_step(address: str, stores: tuple[Store, Store]) -> None:
    record = await stores[0].create("", a_record(), [], None)
    for count in range(1, 4):
        end_connections(address)
        store = stores[count % 2]
        record = await store.update(await store.load_record("", "one", None), after_telling(record, 1), [], None)
        await stores[0].check()
    assert same(await stores[1].load_record("", "one", None), record)
    assert len(record.told) == 3


async def test_changes_are_heard_after_the_listening_connection_was_lost(
    address: str, stores: tuple[Store, Store]
) -> None:
    record = await stores[0].create("", a_record(), [], None)
    for count in range(2):
        end_connections(address, "query LIKE 'LISTEN%' OR query = 'SELECT 1'")
        change = stores[1].changes.expect("one")
        record = await stores[0].update(record, after_telling(record, count + 1), [], None)
        async with asyncio.timeout(60):
            await change.wait()


async def test_a_server_that_hangs_is_not_waited_for(
    postgresql: PostgresqlServer, stores: tuple[Store, Store], monkeypatch: pytest.MonkeyPatch
) -> None:
    record = await stores[0].create("", a_record(), [], None)
    monkeypatch.setattr(postgresql_store, "_LONGEST", 0.5)
    monkeypatch.setattr(postgresql_store, "_PATIENCE", 1.0)
    with postgresql.frozen():
        calls = [store.load_session("", "one") for store in stores for _ in range(20)]
        calls += [store.check() for store in stores]
        async with asyncio.timeout(120):
            outcomes = await asyncio.gather(*calls, return_exceptions=True)
        assert {type(outcome) for outcome in outcomes} == {Unavailable}
    monkeypatch.undo()
    async with asyncio.timeout(120):
        while True:
            with contextlib.suppress(Unavailable):
                await stores[1].check()
                break
    assert same(await stores[1].load_record("", "one", None), record)


async def test_a_scene_that_is_removed_and_stored_at_once_stays_whole(stores: tuple[Store, Store]) -> None:
    async def come_and_go(store: Store, name: str) -> None:
        for count in range(12):
            record = await store.create("", a_record(f"{name}{count}"), [], None)
            assert same((await store.load_record("", record.id, None)).scene, record.scene)
            await store.remove("", record.id)

    await asyncio.gather(*(come_and_go(store, name) for store, name in zip(stores * 2, "abcd", strict=True)))
    assert await stores[0].used_bytes() == 0


async def test_a_database_of_a_newer_version_is_refused(address: str, stores: tuple[Store, Store]) -> None:
    execute(address, "INSERT INTO schema_version (version) VALUES (999)")
    with pytest.raises(Unavailable, match="version 999"):
        async with open_store(address):
            pass


async def test_a_database_that_becomes_read_only_is_unavailable(address: str, stores: tuple[Store, Store]) -> None:
    name = address.partition("?")[0].rpartition("/")[2]
    execute(address, f"ALTER DATABASE {name} SET default_transaction_read_only = on")
    end_connections(address)
    with pytest.raises(Unavailable, match="read-only"):
        await stores[0].check()
