"""The use cases of sessions, shared by REST and gRPC."""

from __future__ import annotations

import asyncio
import hashlib
import secrets
import time
from collections import OrderedDict
from collections.abc import AsyncGenerator, Awaitable, Callable, Coroutine
from contextlib import nullcontext
from typing import Any, TypeVar
from weakref import WeakValueDictionary

import numpy as np
import structlog
from numpy.typing import NDArray

from pretouch.camera import DepthImage
from pretouch.errors import Conflict, Internal, InvalidInput, PretouchError, problem
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
from pretouch.tof import RangeSamples
from pretouch.wire.session import request_to_proto
from pretouch_orchestrator.sessions.endings import end_session
from pretouch_orchestrator.sessions.events import Broker, derive_events
from pretouch_orchestrator.sessions.loop import Loop
from pretouch_orchestrator.sessions.progress import ScanAssessments
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.sessions.told import add_told, check_open
from pretouch_orchestrator.sessions.transitions import get_pending_plan
from pretouch_orchestrator.store.protocol import Event, KeyedRequest, Store

DEFAULT_PAGE, MAX_PAGE = 50, 200
MAX_KEY = 255
_MAX_CACHED = 16
_BYTES_A_PIXEL = 24
"""Memory for each pixel while a depth image is converted to metres."""
_DEFECT = Internal(
    "The orchestrator met a defect of its own in this step.",
    "Open a new session, and report the defect with the service's log of this moment.",
)

T = TypeVar("T")


class SessionManager:
    """Creates, advances and ends sessions. Each session takes one step at a time.

    A step is committed to the store before it is answered. It also runs to its end if its client hangs up: when the
    client asks again, the result is there.
    """

    def __init__(self, store: Store, loop: Loop, context: ServiceContext) -> None:
        self._store = store
        self._loop = loop
        self._context = context
        self._broker = Broker(store)
        self._assessments = ScanAssessments(loop, context.log)
        self._locks: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()
        self._cache: OrderedDict[str, Record] = OrderedDict()
        self._steps: set[asyncio.Task[Any]] = set()
        self._created = context.metrics.counter("sessions_created", "Sessions that were opened.")
        self._ended = context.metrics.counter("sessions_ended", "Sessions that ended.", ("state",))
        self._answered = context.metrics.counter(
            "scans_answered", "Planned scans that a client answered for.", ("kind",)
        )
        self._seconds = context.metrics.histogram("step_seconds", "From a request to its stored answer.", ("step",))

    async def create(
        self,
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
            Unavailable: an upstream service or the proposer is not available; nothing was created.
        """
        if key is not None and not (0 < len(key) <= MAX_KEY and key.isprintable()):
            raise InvalidInput(
                f"The idempotency key is {key!r:.80}.", f"Send 1 to {MAX_KEY} printable characters, such as a UUID."
            )
        return await self._run_step("create", self._create(request, values, mask, key))

    async def submit(self, session_id: str, scan_id: str, read: Callable[[], Awaitable[Submission]]) -> Session:
        """The session after its planned scan was answered; the present session if the scan was answered before.

        Args:
            read: reads and decodes what the client sent; not called for a scan that was answered before.

        Raises:
            NotFound: no such session or scan.
            Conflict: the session has ended, or another scan is planned.
            InvalidInput: the submission cannot be used.
            Unavailable: an upstream service is not available; the session is unchanged.
        """
        record = self._cache.get(session_id) or await self._store.load_record(session_id)
        if scan_id in record.answered:
            return record.to_session()
        submission = await read()
        with structlog.contextvars.bound_contextvars(session=session_id, scan=scan_id):
            return await self._run_step("scan", self._submit(session_id, scan_id, submission))

    async def tell(self, session_id: str, scan_id: str, read: Callable[[], Awaitable[Telling]]) -> ScanProgress:
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
        record = self._cache.get(session_id) or await self._store.load_record(session_id)
        check_open(record, scan_id)
        get_pending_plan(record, scan_id)
        with structlog.contextvars.bound_contextvars(session=session_id, scan=scan_id):
            telling = await read()
            told = await self._loop.fetch_samples(telling) if isinstance(telling, GatewaySpan) else telling
            record = await self._run_step("tell", self._tell(session_id, scan_id, told))
            return await self._assessments.get_progress(record)

    async def cancel(self, session_id: str) -> Session:
        """Cancels a session; one that has already ended keeps its state.

        Raises:
            NotFound: no such session.
        """
        with structlog.contextvars.bound_contextvars(session=session_id):
            return await self._run_step("cancel", self._cancel(session_id))

    async def get(self, session_id: str) -> Session:
        """The present session; raises `NotFound`."""
        return await self._store.load_session(session_id)

    async def list_page(self, limit: int, cursor: str) -> tuple[list[Session], str]:
        """At most `limit` sessions, the newest first, and the next page's cursor.

        The first page has the cursor "", and after the last page the next cursor is "".

        Raises:
            InvalidInput: an invalid limit or cursor.
        """
        if not 1 <= limit <= MAX_PAGE:
            raise InvalidInput(f"limit is {limit}.", f"Send a limit from 1 to {MAX_PAGE}.")
        if cursor and not (cursor.isascii() and cursor.isdigit() and len(cursor) < 19):
            raise InvalidInput(f"cursor is {cursor!r:.80}.", "Send `next` of the previous page unchanged.")
        sessions, last = await self._store.list_sessions(limit, int(cursor) if cursor else None)
        return sessions, "" if last is None else str(last)

    def follow(self, session_id: str, after: int, heartbeat: float | None = None) -> AsyncGenerator[Event | None]:
        """See `Broker.follow`."""
        return self._broker.follow(session_id, after, heartbeat)

    def end_streams(self) -> None:
        """Ends all event streams because the service stops."""
        self._broker.close()

    async def close(self) -> None:
        """Cancels the steps under way. Nothing is lost: their clients have not been answered."""
        for task in self._steps:
            task.cancel()
        await asyncio.gather(*self._steps, return_exceptions=True)
        await self._assessments.close()

    async def _create(
        self,
        request: SessionRequest,
        values: NDArray[np.generic],
        mask: NDArray[np.generic] | None,
        key: str | None,
    ) -> Session:
        async with nullcontext() if key is None else self._lock(f"key {key}"):
            keyed = None
            if key is not None:
                keyed = KeyedRequest(key, await self._context.run_in_thread(_fingerprint, request, values, mask))
                if (existing := await self._find_created(keyed)) is not None:
                    return existing
            depth = await self._context.run_in_thread(
                DepthImage.from_values, values, request.depth_scale, memory=_BYTES_A_PIXEL * values.size
            )
            session_id = secrets.token_hex(8)
            with structlog.contextvars.bound_contextvars(session=session_id):
                object_mask = None if mask is None else mask != 0
                record = await self._loop.open(session_id, time.time(), request, depth, object_mask)
                session = record.to_session()
                await self._store.create(record, derive_events(None, session), keyed)
                self._cache_record(record)
                self._created.inc()
                self._count_end(session)
                self._context.log.info("session opened", state=session.state, proposer=session.proposer)
            return session

    async def _find_created(self, keyed: KeyedRequest) -> Session | None:
        """The session that was created with the same key before; raises `Conflict` if the request was another one."""
        if (found := await self._store.find_keyed(keyed.key)) is None:
            return None
        earlier, session_id = found
        if earlier != keyed:
            raise Conflict(
                f"The idempotency key {keyed.key!r:.80} came with another request before.",
                "Use a new key for each new request.",
            )
        return await self._store.load_session(session_id)

    async def _submit(self, session_id: str, scan_id: str, submission: Submission) -> Session:
        async with self._lock(session_id):
            record = await self._load_record(session_id)
            if scan_id not in record.answered:
                self._assessments.drop(session_id)
            try:
                after = await self._loop.advance(record, scan_id, submission)
            except Exception as error:
                if isinstance(error, PretouchError) and not isinstance(error, Internal):
                    raise
                self._context.log.error("a step met a defect", exc_info=error)
                reason = error if isinstance(error, Internal) else _DEFECT
                after = end_session(record, State.FAILED, problem(reason))
            if after is record:
                return record.to_session()
            session = await self._commit(record, after)
            self._answered.labels(type(submission).__name__).inc()
            return session

    async def _tell(self, session_id: str, scan_id: str, told: SampleChunk | RangeSamples) -> Record:
        async with self._lock(session_id):
            record = await self._load_record(session_id)
            check_open(record, scan_id)
            get_pending_plan(record, scan_id)
            after = add_told(record, told)
            if after is not record:
                self._cache.pop(session_id, None)
                await self._store.update(after, [])
                self._cache_record(after)
            self._assessments.start(after)
            return after

    async def _cancel(self, session_id: str) -> Session:
        async with self._lock(session_id):
            record = await self._load_record(session_id)
            self._assessments.drop(session_id)
            after = end_session(record, State.CANCELLED)
            return record.to_session() if after is record else await self._commit(record, after)

    async def _commit(self, before: Record, after: Record) -> Session:
        """Stores a step, publishes its events, and returns the session after it."""
        session = after.to_session()
        self._cache.pop(before.id, None)
        await self._store.update(after, derive_events(before.to_session(), session))
        self._cache_record(after)
        self._broker.publish(after.id)
        self._count_end(session)
        if session.estimate.sensor_problem:
            self._context.log.warning("the sensor measured nothing", problem=session.estimate.sensor_problem)
        self._context.log.info("session updated", state=session.state, scans=session.budget_used.scans)
        return session

    async def _load_record(self, session_id: str) -> Record:
        """Call it with the session's lock held: otherwise a concurrent step could leave an outdated record cached."""
        record = self._cache.get(session_id) or await self._store.load_record(session_id)
        self._cache_record(record)
        return record

    def _cache_record(self, record: Record) -> None:
        """Keeps the records used last in memory, together with what their scenes have computed lazily."""
        self._cache[record.id] = record
        self._cache.move_to_end(record.id)
        if len(self._cache) > _MAX_CACHED:
            self._cache.popitem(last=False)

    def _count_end(self, session: Session) -> None:
        if session.state.ended:
            self._ended.labels(session.state.value).inc()

    def _lock(self, name: str) -> asyncio.Lock:
        return self._locks.setdefault(name, asyncio.Lock())

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
