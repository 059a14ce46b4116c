"""The use cases of sessions, shared by REST and gRPC."""

from __future__ import annotations

import asyncio
import hashlib
import secrets
import time
from collections.abc import AsyncGenerator, Awaitable, Callable, Coroutine
from contextlib import nullcontext, suppress
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
import structlog
from numpy.typing import NDArray

from pretouch.camera import DepthImage
from pretouch.errors import Conflict, Internal, InvalidInput, PretouchError, Unavailable, problem
from pretouch.serving import ServiceContext
from pretouch.session import (
    GatewaySpan,
    SampleChunk,
    ScanProgress,
    Session,
    SessionRequest,
    State,
    Submission,
    Telling,
)
from pretouch.session_warning import merge_warnings
from pretouch.tof import RangeSamples
from pretouch.wire.session import request_to_proto
from pretouch_orchestrator.cameras.manager import Cameras
from pretouch_orchestrator.sessions.endings import cancel, end_session
from pretouch_orchestrator.sessions.events import Broker, derive_events
from pretouch_orchestrator.sessions.leases import POLL, Leases
from pretouch_orchestrator.sessions.loop import Loop
from pretouch_orchestrator.sessions.progress import ScanAssessments
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.sessions.record_cache import RecordCache
from pretouch_orchestrator.sessions.step_queue import StepQueue
from pretouch_orchestrator.sessions.told import add_told, check_open
from pretouch_orchestrator.sessions.transitions import get_pending_plan
from pretouch_orchestrator.sessions.upkeep import Upkeep, cancel_session
from pretouch_orchestrator.store.changes import wait_for_change
from pretouch_orchestrator.store.protocol import Busy, Event, KeyedRequest, Stale, Store

DEFAULT_PAGE, MAX_PAGE = 50, 200
MAX_KEY = 255
_STEPS_A_WORKER = 4
"""Steps under way for each of the service's threads: about half of a step is the registrar's work."""
_BYTES_A_PIXEL = 24
"""Memory for each pixel while a depth image is converted to metres."""
_DEFECT = Internal(
    "The orchestrator met a defect of its own in this step.",
    "Open a new session, and report the defect with the service's log of this moment.",
)

T = TypeVar("T")


class SessionManager:
    """Creates, advances and ends sessions. Each session takes one step at a time, in whichever process.

    A step is committed to the store before it is answered. It also runs to its end if its client hangs up: when the
    client asks again, of any process, the result is there. Each session belongs to an owner; to another one it does not
    exist.

    Attributes:
        cameras: what the sessions teach of the cameras that they name.
    """

    def __init__(self, store: Store, loop: Loop, context: ServiceContext, upkeep: Upkeep) -> None:
        self._store = store
        self.cameras = Cameras(store, context)
        self._upkeep = upkeep
        self._loop = loop
        self._context = context
        self._broker = Broker(store)
        self._assessments = ScanAssessments(loop, context.log)
        self._leases = Leases(store, context.log)
        self._cache = RecordCache()
        self._queue = StepQueue(_STEPS_A_WORKER * context.settings.workers)
        self._steps: set[asyncio.Task[Any]] = set()
        self._created = context.metrics.counter("sessions_created", "Sessions that were opened.")
        self._ended = context.metrics.counter("sessions_ended", "Sessions that ended.", ("state",))
        self._answered = context.metrics.counter(
            "scans_answered", "Planned scans that a client answered for.", ("kind",)
        )
        self._seconds = context.metrics.histogram("step_seconds", "From a request to its stored answer.", ("step",))

    def check_room(self) -> None:
        """Raises `Overloaded` while a new session would have to wait for long, so that its images need not be read."""
        self._queue.check()

    async def create(
        self,
        owner: str,
        request: SessionRequest,
        values: NDArray[np.generic],
        mask: NDArray[np.generic] | None,
        key: str | None,
    ) -> Session:
        """A new session.

        Args:
            values: (h, w) stored depth values, uint16 or float32.
            mask: (h, w), non-zero on the object.
            key: the client's idempotency key. If the same key came with the same request before, the session created
                then is returned.

        Raises:
            Conflict: the key came with another request before.
            InvalidInput: no object, no depth, a request that does not fit the image.
            Unavailable: an upstream service or the proposer is not available, or the store is full; nothing was
                created.
        """
        if key is not None and not (0 < len(key) <= MAX_KEY and key.isprintable()):
            raise InvalidInput(
                f"The idempotency key is {key!r:.80}.", f"Send 1 to {MAX_KEY} printable characters, such as a UUID."
            )
        return await self._run_step("create", self._create(owner, request, values, mask, key))

    async def submit(
        self, owner: str, session_id: str, scan_id: str, read: Callable[[], Awaitable[Submission]]
    ) -> Session:
        """The session after its planned scan was answered; the present session if the scan was answered before.

        Args:
            read: reads and decodes what the client sent; not called for a scan that was answered before.

        Raises:
            NotFound: no such session or scan.
            Conflict: the session has ended, or another scan is planned.
            InvalidInput: the submission cannot be used.
            Unavailable: an upstream service is not available; the session is unchanged.
        """
        record = await self._load(owner, session_id)
        if scan_id in record.answered:
            return record.to_session()
        self._queue.check()
        submission = await read()
        with structlog.contextvars.bound_contextvars(session=session_id, scan=scan_id):
            return await self._run_step("scan", self._submit(owner, session_id, scan_id, submission))

    async def tell(
        self, owner: str, session_id: str, scan_id: str, read: Callable[[], Awaitable[Telling]]
    ) -> ScanProgress:
        """Takes samples of the planned scan while the robot moves; the scan's progress.

        Samples are stored before the answer, which waits for their assessment only for a moment. What was told before
        counts once.

        Args:
            read: reads and decodes what the client sent; not called for a scan that takes no samples.

        Raises:
            NotFound: no such session or scan.
            Conflict: the session has ended, the scan is closed, or samples before these are missing.
            InvalidInput: the samples cannot be used.
            Unavailable: the gateway is not available; the session is unchanged.
        """
        record = await self._load(owner, session_id)
        check_open(record, scan_id)
        get_pending_plan(record, scan_id)
        with structlog.contextvars.bound_contextvars(session=session_id, scan=scan_id):
            telling = await read()
            told = await self._loop.fetch_samples(telling) if isinstance(telling, GatewaySpan) else telling
            record = await self._run_step("tell", self._tell(owner, session_id, scan_id, told))
            return await self._assessments.get_progress(record)

    async def cancel(self, owner: str, session_id: str, purge: bool = False) -> Session:
        """Cancels a session at once, whatever step is under way; one that has already ended keeps its state.

        Args:
            purge: the session is also removed, with everything that is stored of it.

        Raises:
            NotFound: no such session.
        """
        with structlog.contextvars.bound_contextvars(session=session_id):
            return await self._run_step("cancel", self._cancel(owner, session_id, purge))

    async def get(self, owner: str, session_id: str) -> Session:
        """The present session; raises `NotFound`."""
        return (await self._store.load_session(owner, session_id)).session

    async def load_history(self, owner: str, session_id: str) -> tuple[Record, list[Event]]:
        """The present record, and the events of the types `scan`, `estimate` and `end`; raises `NotFound`."""
        record = await self._load(owner, session_id)
        return record, await self._store.load_events(session_id, 0, without="session")

    async def list_page(self, owner: str, limit: int, cursor: str) -> tuple[list[Session], str]:
        """At most `limit` sessions, the newest first, and the next page's cursor.

        The first page has the cursor "", and after the last page the next cursor is "".

        Raises:
            InvalidInput: an invalid limit or cursor.
        """
        if not 1 <= limit <= MAX_PAGE:
            raise InvalidInput(f"limit is {limit}.", f"Send a limit from 1 to {MAX_PAGE}.")
        if cursor and not (cursor.isascii() and cursor.isdigit() and len(cursor) < 19):
            raise InvalidInput(f"cursor is {cursor!r:.80}.", "Send `next` of the previous page unchanged.")
        sessions, last = await self._store.list_sessions(owner, limit, int(cursor) if cursor else None)
        return sessions, "" if last is None else str(last)

    def follow(
        self, owner: str, session_id: str, after: int, heartbeat: float | None = None
    ) -> AsyncGenerator[Event | None]:
        """See `Broker.follow`."""
        return self._broker.follow(owner, session_id, after, heartbeat)

    def end_streams(self) -> None:
        """Ends all event streams because the service stops."""
        self._broker.close()

    async def close(self) -> None:
        """Cancels the steps under way. Nothing is lost: their clients have not been answered."""
        for task in self._steps:
            task.cancel()
        await asyncio.gather(*self._steps, return_exceptions=True)
        await self._assessments.close()
        await self._leases.close()

    async def _create(
        self,
        owner: str,
        request: SessionRequest,
        values: NDArray[np.generic],
        mask: NDArray[np.generic] | None,
        key: str | None,
    ) -> Session:
        async with nullcontext() if key is None else self._leases.held(f"key {owner} {key}"):
            keyed = None
            if key is not None:
                keyed = KeyedRequest(key, await self._context.run_in_thread(_fingerprint, request, values, mask))
                if (existing := await self._find_created(owner, keyed)) is not None:
                    return existing
            await self._upkeep.make_room()
            session_id = secrets.token_hex(8)
            with structlog.contextvars.bound_contextvars(session=session_id):
                async with self._queue.turn():
                    return await self._open(owner, session_id, request, values, mask, keyed)

    async def _open(
        self,
        owner: str,
        session_id: str,
        request: SessionRequest,
        values: NDArray[np.generic],
        mask: NDArray[np.generic] | None,
        keyed: KeyedRequest | None,
    ) -> Session:
        depth = await self._context.go_on_in_thread(
            DepthImage.from_values, values, request.depth_scale, memory=_BYTES_A_PIXEL * values.size
        )
        object_mask = None if mask is None else mask != 0
        known = await self.cameras.recall(owner, request.camera_id)
        record = await self._loop.open(session_id, time.time(), request, depth, object_mask, known.predict)
        record = replace(record, warnings=merge_warnings(record.warnings, known.warnings))
        session = record.to_session()
        try:
            record = await self.cameras.create(owner, record, derive_events(None, session), keyed)
        except Stale:
            if keyed is None or (existing := await self._find_created(owner, keyed)) is None:
                raise
            return existing
        self._cache.keep(record)
        self._created.inc()
        self._count_end(session)
        self._context.log.info("session opened", state=session.state, proposer=session.proposer)
        return session

    async def _find_created(self, owner: str, keyed: KeyedRequest) -> Session | None:
        """The session that was created with the same key before; raises `Conflict` if the request was another one."""
        if (found := await self._store.find_keyed(owner, keyed.key)) is None:
            return None
        earlier, session_id = found
        if earlier != keyed:
            raise Conflict(
                f"The idempotency key {keyed.key!r:.80} came with another request before.",
                "Use a new key for each new request.",
            )
        return await self.get(owner, session_id)

    async def _submit(self, owner: str, session_id: str, scan_id: str, submission: Submission) -> Session:
        async with self._leases.held(session_id) as lease, self._queue.turn():
            while True:
                record = await self._load(owner, session_id)
                if scan_id not in record.answered:
                    self._assessments.drop(session_id)
                with suppress(Stale):
                    after = await self._advance(record, scan_id, submission)
                    if after is record:
                        return record.to_session()
                    session = await self._commit(owner, record, after, lease)
                    self._answered.labels(type(submission).__name__).inc()
                    return session

    async def _advance(self, record: Record, scan_id: str, submission: Submission) -> Record:
        """The record after the scan, computed for as long as nobody else moves the session on.

        Raises:
            Stale: somebody did: it was cancelled, or this process was so slow that another one took the step over.
        """
        advancing = asyncio.create_task(self._loop.advance(record, scan_id, submission))
        try:
            await self._watch(record, advancing)
            return await advancing
        except Exception as error:
            if isinstance(error, PretouchError) and not isinstance(error, Internal):
                raise
            self._context.log.error("a step met a defect", exc_info=error)
            reason = error if isinstance(error, Internal) else _DEFECT
            return end_session(record, State.FAILED, problem(reason))
        finally:
            advancing.cancel()
            await asyncio.gather(advancing, return_exceptions=True)

    async def _watch(self, record: Record, advancing: asyncio.Task[Record]) -> None:
        """Returns when the step is computed; raises `Stale` once the record is not the session's present state."""
        while not advancing.done():
            change = self._store.changes.expect(record.id)
            changed = asyncio.create_task(change.wait())
            try:
                await asyncio.wait((advancing, changed), return_when=asyncio.FIRST_COMPLETED)
            finally:
                changed.cancel()
            with suppress(Unavailable):  # whether the step counts is decided by the commit
                if not advancing.done() and not await self._store.is_present(record):
                    raise Stale

    async def _tell(self, owner: str, session_id: str, scan_id: str, told: SampleChunk | RangeSamples) -> Record:
        while True:
            change = self._store.changes.expect(session_id)
            record = await self._load(owner, session_id)
            check_open(record, scan_id)
            get_pending_plan(record, scan_id)
            after = add_told(record, told)
            try:
                if after is not record:
                    after = await self._store.update(record, after, [], lease=None)
            except Stale:
                continue
            except Busy:
                await wait_for_change(change, POLL)
                continue
            self._cache.keep(after)
            self._assessments.start(after)
            return after

    async def _cancel(self, owner: str, session_id: str, purge: bool) -> Session:
        before = (await cancel_session(self._store, owner, session_id)).session
        session = cancel(before)
        self._assessments.drop(session_id)
        self._cache.drop(session_id)
        if session is not before:
            self._count_end(session)
            self._context.log.info("session cancelled", scans=session.budget_used.scans)
        if purge:
            await self._store.remove(owner, session_id)
        return session

    async def _commit(self, owner: str, before: Record, after: Record, lease: str) -> Session:
        """Stores a step with its events, and returns the session after it."""
        session = after.to_session()
        events = derive_events(before.to_session(), session)
        self._cache.keep(await self.cameras.update(owner, before, after, events, lease))
        self._count_end(session)
        if session.estimate.sensor_problem:
            self._context.log.warning("the sensor measured nothing", problem=session.estimate.sensor_problem)
        self._context.log.info("session updated", state=session.state, scans=session.budget_used.scans)
        return session

    async def _load(self, owner: str, session_id: str) -> Record:
        """The session's present record."""
        record = await self._store.load_record(owner, session_id, self._cache.get(session_id))
        self._cache.keep(record)
        return record

    def _count_end(self, session: Session) -> None:
        if session.state.ended:
            self._ended.labels(session.state.value).inc()

    async def _run_step(self, name: str, step: Coroutine[Any, Any, T]) -> T:
        """The step's result; the step continues if the caller is cancelled."""
        task = asyncio.create_task(step)
        self._steps.add(task)
        task.add_done_callback(self._steps.discard)
        with self._seconds.labels(name).time():
            return await asyncio.shield(task)


def _fingerprint(request: SessionRequest, values: NDArray[np.generic], mask: NDArray[np.generic] | None) -> str:
    """SHA-256 of what was requested, however it was encoded."""
    return hashlib.sha256(request_to_proto(request, values, mask).SerializeToString(deterministic=True)).hexdigest()
