"""Steps of one session at once, in one orchestrator or in two on one store: each counts once, none is lost."""

from __future__ import annotations

import asyncio
import tempfile
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack, suppress
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.postgresql import PostgresqlServer
from helpers.records import a_record
from helpers.stores import KINDS
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_orchestrator.sessions import leases
from pretouch_orchestrator.sessions.manager import SessionManager
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.sessions.upkeep import Limits, Upkeep
from pretouch_orchestrator.store import open_store
from pretouch_orchestrator.store.protocol import NewEvent, Store

from pretouch.errors import Conflict, InvalidInput, NotFound, Unavailable
from pretouch.serving import ServiceContext, Settings
from pretouch.session import SampleChunk, ScanSummary, Skipped, State
from pretouch.tof import RangeSamples, Scan


class HeldLoop:
    """A loop whose scans each add their own name to the session, once `go` is set.

    Attributes:
        started: names of the scans whose computation began; `cancelled`: of those that were stopped.
    """

    def __init__(self) -> None:
        self.started: list[str] = []
        self.cancelled: list[str] = []
        self.begun, self.go = asyncio.Event(), asyncio.Event()
        self.go.set()
        self.error: Exception | None = None

    async def open(self, id: str, created: float, *_: Any) -> Record:
        self.started.append(id)
        self.begun.set()
        await self.go.wait()
        return replace(a_record(id), created=created)

    async def advance(self, record: Record, scan_id: str, submission: object) -> Record:
        if scan_id in record.answered:
            return record
        if record.state.ended:
            raise Conflict("The session has ended.")
        self.started.append(scan_id)
        self.begun.set()
        try:
            await self.go.wait()
        except asyncio.CancelledError:
            self.cancelled.append(scan_id)
            raise
        if self.error is not None:
            raise self.error
        beams = Scan(np.full((3, 3), 1 / 3), np.tile([0.0, 0.0, -1.0], (3, 1)), np.array([0.03, np.nan, 0.1 / 3]))
        assert record.next_scan is not None
        return replace(
            record,
            answered=(*record.answered, scan_id),
            scans=(*record.scans, ScanSummary(scan_id, "line-3", None, 3, 2, 0.1, 2.0, 0.01)),
            measured=(*record.measured, beams),
            told=(),
            next_scan=replace(record.next_scan, scan_id=f"after {scan_id}"),
        )

    async def assess(self, record: Record) -> Any:
        raise Unavailable("This loop assesses nothing.", "")


class Orchestrator:
    """A manager with a loop of its own."""

    def __init__(self, store: Store) -> None:
        self.store = store
        self.loop = HeldLoop()
        self.context = ServiceContext("orchestrator", Settings())
        upkeep = Upkeep(store, Limits(3600.0, 2**30), self.context.log)
        self.sessions = SessionManager(store, self.loop, self.context, upkeep)  # type: ignore[arg-type]

    async def submit(self, scan_id: str, owner: str = "") -> list[str]:
        """The scans of the session "one" after this one."""

        async def read() -> Skipped:
            return Skipped()

        return [scan.scan_id for scan in (await self.sessions.submit(owner, "one", scan_id, read)).scans]

    async def tell(self, scan_id: str, start: int, count: int) -> int:
        """How many samples of the pending scan of "one" are told after these."""
        poses = np.tile(np.eye(4), (count, 1, 1))
        zeros = np.zeros(count, int)
        samples = RangeSamples((start + np.arange(count)) / 3, poses, np.full(count, 0.03), zeros, zeros)

        async def read() -> SampleChunk:
            return SampleChunk(start, samples)

        return (await self.sessions.tell("", "one", scan_id, read)).told


@pytest.fixture
async def start(store_address: str) -> AsyncIterator[Callable[[], Awaitable[Orchestrator]]]:
    """Starts orchestrators on one store; of SQLite they share the one that is open, as two calls of one process do."""
    async with AsyncExitStack() as stack:
        stores: list[Store] = []

        async def started() -> Orchestrator:
            if not stores or store_address.startswith("postgresql"):
                stores.append(await stack.enter_async_context(open_store(store_address)))
                if len(stores) == 1:
                    await stores[0].create("", a_record("one"), [NewEvent("session", {})], None)
            orchestrator = Orchestrator(stores[-1])
            stack.callback(orchestrator.context.close)
            stack.push_async_callback(orchestrator.sessions.close)
            return orchestrator

        yield started


Start = Callable[[], Awaitable[Orchestrator]]


async def test_a_scan_sent_to_two_at_once_is_computed_once(start: Start) -> None:
    a, b = await start(), await start()
    a.loop.go.clear()
    first = asyncio.create_task(a.submit("s1"))
    await a.loop.begun.wait()
    others = [asyncio.create_task(each.submit("s1")) for each in (b, a, b)]
    await asyncio.wait(others, timeout=0.2)
    a.loop.go.set()
    assert await asyncio.gather(first, *others) == [["s1"]] * 4
    assert (a.loop.started, b.loop.started) == (["s1"], [])
    assert await b.submit("s2") == ["s1", "s2"]
    assert await a.submit("s3") == ["s1", "s2", "s3"]
    assert [scan.ranges[0] for scan in (await b.store.load_record("", "one", None)).measured] == [0.03] * 3


async def test_a_scan_that_failed_at_one_is_computed_by_the_other_who_waited(start: Start) -> None:
    a, b = await start(), await start()
    a.loop.go.clear()
    a.loop.error = Unavailable("The registrar is away.", "")
    first = asyncio.create_task(a.submit("s1"))
    await a.loop.begun.wait()
    second = asyncio.create_task(b.submit("s1"))
    await asyncio.wait([second], timeout=0.2)
    a.loop.go.set()
    with pytest.raises(Unavailable):
        await first
    assert await second == ["s1"]


async def test_a_cancellation_takes_effect_at_once_whoever_steps(start: Start) -> None:
    for purge in (False, True):
        a, b = await start(), await start()
        if purge:
            await a.store.remove("", "one")
            await a.store.create("", a_record("one"), [], None)
        a.loop.go.clear()
        step = asyncio.create_task(a.submit("s1"))
        await a.loop.begun.wait()
        assert (await b.sessions.cancel("", "one", purge)).state is State.CANCELLED
        with pytest.raises((NotFound, Conflict) if purge else Conflict):
            await step
        assert a.loop.cancelled == ["s1"]
    with pytest.raises(NotFound):
        await b.sessions.cancel("", "one")


async def test_a_step_of_a_process_that_died_is_taken_over_and_cannot_count_afterwards(
    start: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(leases, "LIFETIME", 0.5)
    monkeypatch.setattr(leases, "_RENEWAL", 1000.0)
    a, b = await start(), await start()
    a.loop.go.clear()
    stopped = asyncio.create_task(a.submit("s1"))
    await a.loop.begun.wait()
    assert await b.submit("s1") == ["s1"]
    assert b.loop.started == ["s1"]
    a.loop.go.set()
    assert await stopped == ["s1"]
    assert len(await a.store.load_events("one", 0)) == 1 + 2, "one scan and one session"


async def test_a_long_step_keeps_its_lease(start: Start, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(leases, "LIFETIME", 2.0)
    monkeypatch.setattr(leases, "_RENEWAL", 0.05)
    monkeypatch.setattr(leases, "POLL", 0.05)
    a, b = await start(), await start()
    a.loop.go.clear()
    first = asyncio.create_task(a.submit("s1"))
    await a.loop.begun.wait()
    second = asyncio.create_task(b.submit("s1"))
    await asyncio.wait([second], timeout=3.0)
    a.loop.go.set()
    assert [await first, await second] == [["s1"], ["s1"]]
    assert b.loop.started == []


async def test_samples_told_to_either_add_up_and_wait_for_a_step(start: Start) -> None:
    a, b = await start(), await start()
    assert [await each.tell("s2", 3 * k, 3) for k, each in enumerate((a, b, b, a))] == [3, 6, 9, 12]
    assert await b.tell("s2", 0, 3) == 12, "told before"
    with pytest.raises(Conflict, match="told is 12"):
        await a.tell("s2", 13, 1)
    at_once = await asyncio.gather(*(each.tell("s2", 12, 3) for each in (a, b, a, b)))
    assert at_once == [15] * 4
    assert len((await a.store.load_record("", "one", None)).told_samples) == 15
    a.loop.go.clear()
    step = asyncio.create_task(a.submit("s2"))
    await a.loop.begun.wait()
    late = asyncio.create_task(b.tell("s2", 15, 1))
    await asyncio.wait([late], timeout=0.2)
    assert not late.done()
    a.loop.go.set()
    assert await step == ["s2"]
    with pytest.raises(Conflict, match="closed"):
        await late
    assert await b.tell("after s2", 0, 2) == 2


async def test_a_key_sent_to_two_at_once_opens_one_session(start: Start) -> None:
    a, b = await start(), await start()
    depth, request = np.ones((4, 4), np.uint16), a_record().request

    async def create(each: Orchestrator, owner: str = "ann", depth_value: int = 1) -> str:
        return (await each.sessions.create(owner, request, depth * depth_value, None, "k")).id

    a.loop.go.clear()
    first = asyncio.create_task(create(a))
    await a.loop.begun.wait()
    others = [asyncio.create_task(create(each)) for each in (b, a)]
    bobs = await create(b, "bob")
    a.loop.go.set()
    ids = await asyncio.gather(first, *others)
    assert len(set(ids)) == 1
    assert bobs not in ids
    assert len(a.loop.started) + len(b.loop.started) == 2
    with pytest.raises(Conflict, match="another request"):
        await create(b, depth_value=2)


async def test_events_of_steps_elsewhere_are_followed(start: Start) -> None:
    a, b = await start(), await start()
    seen: list[str] = []
    replayed = asyncio.Event()

    async def follow() -> None:
        async for event in a.sessions.follow("", "one", 0):
            assert event is not None
            seen.append(f"{event.id} {event.type}")
            replayed.set()

    following = asyncio.create_task(follow())
    await replayed.wait()
    await b.submit("s1")
    await b.sessions.cancel("", "one")
    async with asyncio.timeout(60):
        await following
    assert seen == ["1 session", "2 scan", "3 session", "4 session", "5 end"]


async def test_a_follower_of_a_removed_session_is_let_go(start: Start) -> None:
    a, b = await start(), await start()
    events = a.sessions.follow("", "one", 0)
    assert await anext(events) is not None
    following = asyncio.ensure_future(anext(events, None))
    await asyncio.sleep(0)
    await b.store.remove("", "one")
    async with asyncio.timeout(60):
        assert await following is None


async def test_another_owner_does_not_find_the_session(start: Start) -> None:
    a = await start()
    for call in (
        a.submit("s1", "bob"),
        a.sessions.cancel("bob", "one", True),
        a.sessions.get("bob", "one"),
        anext(a.sessions.follow("bob", "one", 0)),
    ):
        with pytest.raises(NotFound):
            await call
    assert (await a.sessions.get("", "one")).state is State.AWAITING_SCAN
    assert (await a.sessions.list_page("bob", 10, ""))[0] == []


async def test_a_repeated_submission_is_not_read(start: Start) -> None:
    a, b = await start(), await start()

    async def read_nothing() -> Skipped:
        raise AssertionError("a repeated submission was read")

    await a.submit("s1")
    again = await b.sessions.submit("", "one", "s1", read_nothing)
    assert [scan.scan_id for scan in again.scans] == ["s1"]
    with pytest.raises(InvalidInput):
        await a.sessions.list_page("", 0, "")


@pytest.fixture(scope="module")
def shared_database(postgresql: PostgresqlServer) -> str:
    """One for all examples: a new one for each takes longer than the example."""
    return postgresql.new_database()


@settings(max_examples=15)
@given(
    calls=st.lists(
        st.tuples(st.sampled_from([0, 1]), st.sampled_from(["submit", "tell", "cancel", "get"]), st.integers(0, 3)),
        min_size=2,
        max_size=12,
    )
)
@pytest.mark.parametrize("kind", KINDS)
def test_calls_in_any_order_leave_one_history(
    kind: str, calls: list[tuple[int, str, int]], request: pytest.FixtureRequest
) -> None:
    """Robots call two orchestrators at once: each sends the scan that it believes is next, tells of it, or cancels."""
    with tempfile.TemporaryDirectory() as folder:
        address = f"sqlite:{folder}"
        if kind == "postgresql":
            address = request.getfixturevalue("shared_database")
        asyncio.run(call_at_once(address, calls))


async def call_at_once(address: str, calls: list[tuple[int, str, int]]) -> None:
    async with AsyncExitStack() as stack:
        store = await stack.enter_async_context(open_store(address))
        other = await stack.enter_async_context(open_store(address)) if address.startswith("postgresql") else store
        await store.remove("", "one")
        await store.create("", replace(a_record("one"), answered=()), [NewEvent("session", {})], None)
        orchestrators = []
        for each in (store, other):
            orchestrators.append(Orchestrator(each))
            stack.callback(orchestrators[-1].context.close)
            stack.push_async_callback(orchestrators[-1].sessions.close)

        async def call(which: int, what: str, moment: int) -> list[str]:
            """The scans that the call was answered with."""
            await asyncio.sleep(moment / 100)
            orchestrator = orchestrators[which]
            session = await orchestrator.sessions.get("", "one")
            if what == "cancel":
                return [scan.scan_id for scan in (await orchestrator.sessions.cancel("", "one")).scans]
            if session.next_scan is None or what == "get":
                return [scan.scan_id for scan in session.scans]
            with suppress(Conflict, NotFound):
                if what == "submit":
                    return await orchestrator.submit(session.next_scan.scan_id)
                await orchestrator.tell(session.next_scan.scan_id, 0, 2)
            return []

        answers = await asyncio.gather(*(call(*each) for each in calls))
        record = await store.load_record("", "one", None)
        history = [scan.scan_id for scan in record.scans]
        assert history == list(record.answered)
        assert len(record.measured) == len(history) == len(set(history))
        for answer in answers:
            assert answer == history[: len(answer)], "every answered scan was kept"
        events = await store.load_events("one", 0)
        assert [event.id for event in events] == list(range(1, len(events) + 1))
        kinds = [event.type for event in events]
        assert kinds.count("scan") == len(history)
        assert kinds.count("end") == (record.state is State.CANCELLED) == any(what == "cancel" for _, what, _ in calls)
