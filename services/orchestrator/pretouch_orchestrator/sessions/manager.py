"""What can be done with sessions: the use cases that REST and gRPC share."""

from __future__ import annotations

import asyncio
import hashlib
import secrets
import time
from collections import OrderedDict
from collections.abc import AsyncGenerator, Coroutine
from typing import Any, TypeVar
from weakref import WeakValueDictionary

import numpy as np
import structlog
from numpy.typing import NDArray

from pretouch.camera import DepthImage
from pretouch.errors import Conflict, Internal, InvalidInput, PretouchError, Unavailable
from pretouch.serving import ServiceContext
from pretouch.session import GatewaySpan, Session, SessionRequest, Submission
from pretouch.tof import RangeSamples
from pretouch.wire.session import request_to_proto
from pretouch_orchestrator.sessions.events import Broker, events_between
from pretouch_orchestrator.sessions.loop import Loop
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.store.protocol import Event, KeyedRequest, Store
from pretouch_orchestrator.upstream.interfaces import Gateway

DEFAULT_PAGE, LARGEST_PAGE = 50, 200
LONGEST_KEY = 255
_KEPT_RECORDS = 16
_DEFECT = Internal(
    "The orchestrator met a defect of its own in this step.",
    "Open a new session; report it with the service's log of this moment.",
)

T = TypeVar("T")


class Sessions:
    """All sessions. A step is in the store before its answer leaves, and one session takes one step at a time.

    A step that a client gave up waiting for goes on: when the client asks again, the answer is there.

    Args:
        gateway: None where the orchestrator was started without one.
    """

    def __init__(self, store: Store, loop: Loop, gateway: Gateway | None, context: ServiceContext) -> None:
        self._store = store
        self._loop = loop
        self._gateway = gateway
        self._context = context
        self._broker = Broker(store)
        self._locks: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()
        self._records: OrderedDict[str, Record] = OrderedDict()
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
            key: the client's idempotency key. The same key with the same request answers the session it made.

        Raises:
            Conflict: the key came with another request before.
            InvalidInput: no object, no depth, a request that does not fit the image.
            Unavailable: an upstream service or the proposer is not there; nothing was created.
        """
        if key is not None and not (0 < len(key) <= LONGEST_KEY and key.isprintable()):
            raise InvalidInput(
                f"The idempotency key is {key!r:.80}.", f"Send 1 to {LONGEST_KEY} printable characters, such as a UUID."
            )
        return await self._step("create", self._create(request, values, mask, key))

    async def answered(self, session_id: str, scan_id: str) -> Session | None:
        """The present session if the scan was answered before, whatever was said of it then; else None.

        Raises:
            NotFound: no such session.
        """
        record = self._records.get(session_id) or await self._store.record(session_id)
        return record.view() if scan_id in record.answered else None

    async def submit(self, session_id: str, scan_id: str, submission: Submission) -> Session:
        """The session after its planned scan was answered; as it is if the scan was answered before.

        Raises:
            NotFound: no such session or scan.
            Conflict: the session has ended, or another scan is planned.
            InvalidInput: the submission cannot be used.
            Unavailable: an upstream service is not there; the session is as it was.
        """
        with structlog.contextvars.bound_contextvars(session=session_id, scan=scan_id):
            return await self._step("scan", self._submit(session_id, scan_id, submission))

    async def cancel(self, session_id: str) -> Session:
        """The session, ended; one that had ended keeps its state.

        Raises:
            NotFound: no such session.
        """
        with structlog.contextvars.bound_contextvars(session=session_id):
            return await self._step("cancel", self._cancel(session_id))

    async def get(self, session_id: str) -> Session:
        """Where a session stands; raises `NotFound`."""
        return await self._store.session(session_id)

    async def page(self, limit: int, cursor: str) -> tuple[list[Session], str]:
        """At most `limit` sessions, the newest first, and the cursor of the next page; empty cursors: first and last.

        Raises:
            InvalidInput: a limit or cursor that cannot be.
        """
        if not 1 <= limit <= LARGEST_PAGE:
            raise InvalidInput(f"limit is {limit}.", f"Send a limit from 1 to {LARGEST_PAGE}.")
        if cursor and not (cursor.isascii() and cursor.isdigit() and len(cursor) < 19):
            raise InvalidInput(f"cursor is {cursor!r:.80}.", "Send `next` of the page before, as it was given.")
        sessions, last = await self._store.page(limit, int(cursor) if cursor else None)
        return sessions, "" if last is None else str(last)

    def follow(self, session_id: str, after: int, heartbeat: float | None = None) -> AsyncGenerator[Event | None]:
        """See `Broker.follow`."""
        return self._broker.follow(session_id, after, heartbeat)

    def end_streams(self) -> None:
        """Ends all streams of events: the service stops."""
        self._broker.close()

    async def close(self) -> None:
        """Drops the steps under way; their clients have not been answered, so nothing is lost."""
        for task in self._steps:
            task.cancel()
        await asyncio.gather(*self._steps, return_exceptions=True)

    async def _create(
        self,
        request: SessionRequest,
        values: NDArray[np.generic],
        mask: NDArray[np.generic] | None,
        key: str | None,
    ) -> Session:
        if key is None:
            return await self._open(request, values, mask, None)
        async with self._lock(f"key {key}"):
            keyed = KeyedRequest(key, await self._context.run_in_thread(_fingerprint, request, values, mask))
            if (found := await self._store.keyed(key)) is None:
                return await self._open(request, values, mask, keyed)
            before, session_id = found
            if before != keyed:
                raise Conflict(
                    f"The idempotency key {key!r:.80} came with another request before.",
                    "Use a new key for each new request.",
                )
            return await self._store.session(session_id)

    async def _open(
        self,
        request: SessionRequest,
        values: NDArray[np.generic],
        mask: NDArray[np.generic] | None,
        key: KeyedRequest | None,
    ) -> Session:
        depth = await self._context.run_in_thread(DepthImage.from_values, values, request.depth_scale)
        session_id = secrets.token_hex(8)
        with structlog.contextvars.bound_contextvars(session=session_id):
            object_mask = None if mask is None else mask != 0
            record = await self._loop.open(session_id, time.time(), request, depth, object_mask)
            session = record.view()
            await self._store.create(record, events_between(None, session), key)
            self._remember(record)
            self._created.inc()
            self._note_end(session)
            self._context.log.info("session opened", state=session.state, proposer=session.proposer)
        return session

    async def _submit(self, session_id: str, scan_id: str, submission: Submission) -> Session:
        async with self._lock(session_id):
            record = await self._record(session_id)
            if scan_id in record.answered:
                return record.view()
            try:
                after = await self._advance(record, scan_id, submission)
            except Exception as error:
                if isinstance(error, PretouchError) and not isinstance(error, Internal):
                    raise
                self._context.log.error("a step met a defect", exc_info=error)
                after = self._loop.fail(record, error if isinstance(error, Internal) else _DEFECT)
            session = await self._keep(record, after)
            self._answered.labels(type(submission).__name__).inc()
            return session

    async def _advance(self, record: Record, scan_id: str, submission: Submission) -> Record:
        if isinstance(submission, GatewaySpan):
            self._loop.check(record, scan_id)
            submission = await self._resolved(submission)
        return await self._loop.advance(record, scan_id, submission)

    async def _cancel(self, session_id: str) -> Session:
        async with self._lock(session_id):
            record = await self._record(session_id)
            return record.view() if record.state.ended else await self._keep(record, self._loop.cancel(record))

    async def _resolved(self, span: GatewaySpan) -> RangeSamples:
        if self._gateway is None:
            raise Unavailable(
                "This orchestrator has no sensor gateway.",
                "Send the samples themselves, or start it with PRETOUCH_ORCHESTRATOR_GATEWAY=host:port.",
            )
        samples = await self._gateway.samples(span)
        if len(samples) == 0:
            raise InvalidInput(
                f"The gateway has no samples from {span.start:.6f} to {span.end:.6f} s.",
                "Give a span of its host's clock during which it was sent tip poses.",
            )
        return samples

    async def _keep(self, before: Record, after: Record) -> Session:
        """Stores a step, tells those who watch, and answers the session."""
        session = after.view()
        self._records.pop(before.id, None)
        await self._store.update(after, events_between(before.view(), session))
        self._remember(after)
        self._broker.publish(after.id)
        self._note_end(session)
        if session.estimate.sensor_problem:
            self._context.log.warning("a scan measured nothing", problem=session.estimate.sensor_problem)
        self._context.log.info("session went on", state=session.state, scans=session.budget_used.scans)
        return session

    async def _record(self, session_id: str) -> Record:
        """To be called with the session's lock held: a step meanwhile would leave an old record in memory."""
        record = self._records.get(session_id) or await self._store.record(session_id)
        self._remember(record)
        return record

    def _remember(self, record: Record) -> None:
        """Keeps the records in use in memory, with what their scenes have computed of themselves."""
        self._records[record.id] = record
        self._records.move_to_end(record.id)
        if len(self._records) > _KEPT_RECORDS:
            self._records.popitem(last=False)

    def _note_end(self, session: Session) -> None:
        if session.state.ended:
            self._ended.labels(session.state.value).inc()

    def _lock(self, name: str) -> asyncio.Lock:
        return self._locks.setdefault(name, asyncio.Lock())

    async def _step(self, name: str, step: Coroutine[Any, Any, T]) -> T:
        """The step's result; it goes on to its end where its caller is cancelled."""
        task = asyncio.create_task(step)
        self._steps.add(task)
        task.add_done_callback(self._steps.discard)
        with self._seconds.labels(name).time():
            return await asyncio.shield(task)


def _fingerprint(request: SessionRequest, values: NDArray[np.generic], mask: NDArray[np.generic] | None) -> str:
    """SHA-256 of what was asked for, the same however it was spelled."""
    return hashlib.sha256(request_to_proto(request, values, mask).SerializeToString(deterministic=True)).hexdigest()
