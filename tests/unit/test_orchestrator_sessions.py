"""Overlapping steps of one session: each starts from the record that the one before stored."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from helpers.records import a_record
from pretouch_orchestrator.sessions.manager import SessionManager
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.store.sqlite import SqliteStore, open_store

from pretouch.serving import ServiceContext, Settings
from pretouch.session import Skipped


class SlowToRead:
    """A store whose first read of a record takes until `go` is set, and then gives what it saw at its start."""

    def __init__(self, store: SqliteStore) -> None:
        self._store = store
        self.reading, self.go = asyncio.Event(), asyncio.Event()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._store, name)

    async def load_record(self, session_id: str) -> Record:
        record = await self._store.load_record(session_id)
        if not self.reading.is_set():
            self.reading.set()
            await self.go.wait()
        return record


class AnswersOnly:
    """A loop that notes which scans were answered."""

    async def advance(self, record: Record, scan_id: str, submission: object) -> Record:
        if scan_id in record.answered:
            return record
        return replace(record, answered=(*record.answered, scan_id))


@pytest.fixture
async def store(tmp_path: Path) -> AsyncIterator[SlowToRead]:
    async with open_store(tmp_path) as opened:
        await opened.create(a_record("one"), [], None)
        yield SlowToRead(opened)


async def read_skipped() -> Skipped:
    return Skipped()


async def read_nothing() -> Skipped:
    raise AssertionError("a repeated submission was read")


async def test_a_look_that_began_before_a_step_does_not_undo_it(store: SlowToRead) -> None:
    context = ServiceContext("orchestrator", Settings())
    sessions = SessionManager(store, AnswersOnly(), context)  # type: ignore[arg-type]
    late = asyncio.create_task(sessions.submit("one", "a", read_skipped))
    await store.reading.wait()
    await sessions.submit("one", "a", read_skipped)
    store.go.set()
    await late
    await asyncio.gather(sessions.submit("one", "b", read_skipped), sessions.submit("one", "c", read_skipped))
    assert sorted((await store.load_record("one")).answered) == ["a", "b", "c"]
    await sessions.close()
    context.close()


async def test_a_repeated_submission_is_not_read(store: SlowToRead) -> None:
    store.go.set()
    context = ServiceContext("orchestrator", Settings())
    sessions = SessionManager(store, AnswersOnly(), context)  # type: ignore[arg-type]
    first = await sessions.submit("one", "a", read_skipped)
    again = await sessions.submit("one", "a", read_nothing)
    assert (again.id, again.scans) == (first.id, first.scans)
    await sessions.close()
    context.close()
