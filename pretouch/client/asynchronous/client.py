"""The base class of the clients: every method, with retries; REST and gRPC add how messages are sent."""

# ruff: noqa: ASYNC109 -- a call's timeout covers its retries, which a timeout around the call could not tell apart

from __future__ import annotations

import asyncio
import time
from abc import abstractmethod
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import aclosing

from pretouch.calibrated_camera import CalibratedCamera, CameraSummary
from pretouch.client.api import AnswerT, MessageT, SessionApi, SessionPage
from pretouch.client.arguments import check_event_id, failing_as
from pretouch.client.asynchronous.calls import REPORT, AsyncCalls
from pretouch.client.events import QUIET, Event, StreamProgress, stream_broken
from pretouch.client.images import ImageLike
from pretouch.errors import DeadlineExceeded, Internal, PretouchError
from pretouch.session import ScanPlan, ScanProgress, Session, SessionRequest, Submission, Telling


class AsyncClient(AsyncCalls[MessageT, AnswerT]):
    """A client of the orchestrator; `async with` closes it.

    Every method takes a `timeout` in seconds for the whole call, retries included, and raises the errors of
    `pretouch.errors`, no others.
    """

    def __init__(self, api: SessionApi[MessageT, AnswerT], timeout: float) -> None:
        super().__init__(timeout)
        self._api = api

    async def create_session(
        self,
        request: SessionRequest,
        depth: ImageLike,
        mask: ImageLike | None = None,
        idempotency_key: str | None = None,
        *,
        timeout: float | None = None,
    ) -> Session:
        """Creates a session for one object.

        Args:
            depth: stored values (h, w) of uint16 or float32; or a 16-bit PNG or an .npy file, as bytes or path.
            mask: (h, w), non-zero on the object; or a PNG file. Left out: the object is found on the table.
            idempotency_key: a repeated key returns the session that the first call created.
        """
        return await self._run(lambda: self._api.create_session(request, depth, mask, idempotency_key), timeout)

    async def session(self, session_id: str, *, timeout: float | None = None) -> Session:
        """Returns the present state of a session."""
        return await self._run(lambda: self._api.session(session_id), timeout)

    async def sessions(self, limit: int = 50, cursor: str = "", *, timeout: float | None = None) -> SessionPage:
        """Returns a page of sessions, the newest first."""
        return await self._run(lambda: self._api.sessions(limit, cursor), timeout)

    async def all_sessions(self, *, timeout: float | None = None) -> AsyncIterator[Session]:
        """Yields every session, the newest first, page by page."""
        cursor, more = "", True
        while more:
            page = await self.sessions(cursor=cursor, timeout=timeout)
            for session in page.sessions:
                yield session
            cursor, more = page.next, bool(page.next)

    async def next_scan(self, session_id: str, *, timeout: float | None = None) -> ScanPlan:
        """Returns the plan of the next scan; raises `Conflict` if there is none."""
        return await self._run(lambda: self._api.next_scan(session_id), timeout)

    async def submit(
        self, session_id: str, scan_id: str, submission: Submission, *, timeout: float | None = None
    ) -> Session:
        """Submits the result of a planned scan. Repeating a scan changes nothing and returns the present session."""
        return await self._run(lambda: self._api.submit(session_id, scan_id, submission), timeout)

    async def tell(
        self, session_id: str, scan_id: str, telling: Telling, *, timeout: float | None = None
    ) -> ScanProgress:
        """Tells samples of a planned scan while the robot moves: the robot may leave the path once they are `enough`.

        Repeating a chunk changes nothing. `submit` closes the scan, with the rest of its samples or none.

        Raises:
            Conflict: the scan is closed, or samples before the chunk are missing; the detail says how many were told.
        """
        return await self._run(lambda: self._api.tell(session_id, scan_id, telling), timeout)

    async def cancel(self, session_id: str, *, purge: bool = False, timeout: float | None = None) -> None:
        """Cancels a session at once, whatever step is under way; one that has ended keeps its state.

        With `purge` it is also removed, with all that is stored of it but what its camera has learned.
        """
        await self._run(lambda: self._api.cancel(session_id, purge), timeout)

    async def cameras(self, *, timeout: float | None = None) -> tuple[CameraSummary, ...]:
        """Returns the cameras that sessions have named, in the order of their names."""
        return await self._run(lambda: self._api.cameras(), timeout)

    async def camera(self, camera_id: str, *, timeout: float | None = None) -> CalibratedCamera:
        """Returns what is known of a camera: its calibration error, whether it has moved, and its sessions."""
        return await self._run(lambda: self._api.camera(camera_id), timeout)

    async def forget_camera(self, camera_id: str, *, timeout: float | None = None) -> None:
        """Forgets all that was learned of a camera; its sessions stay."""
        await self._run(lambda: self._api.forget_camera(camera_id), timeout)

    async def events(self, session_id: str, after: int = 0) -> AsyncIterator[Event]:
        """Yields the session's events after the id `after`, each once, until its end; broken streams are resumed.

        The client's timeout limits the attempts to reconnect, not the time between events.
        """
        progress = StreamProgress(check_event_id(after), self._timeout)
        while True:
            start, began = progress.after, time.monotonic()
            try:
                self._check_open()
                async with aclosing(self._events_of_one_stream(session_id, start)) as events:
                    async for event in events:
                        if not progress.record(event):
                            continue
                        yield event
                        if progress.ended:
                            return
                if progress.after == start:
                    session = await self.session(session_id)
                    if session.state.ended:
                        return
                raise stream_broken()
            except PretouchError as error:
                self._check_open(error)
                if isinstance(error, DeadlineExceeded) and time.monotonic() - began >= QUIET:
                    await self.session(session_id)  # it answers: there was nothing to tell
                    progress.start_anew()
                else:
                    await asyncio.sleep(progress.delay_after(error, self._reached))

    async def _events_of_one_stream(self, session_id: str, after: int) -> AsyncGenerator[Event]:
        with failing_as(Internal, "The event stream failed", REPORT):
            async with aclosing(self._listen(session_id, after)) as events:
                async for event in events:
                    self._reached = True
                    yield event

    @abstractmethod
    def _listen(self, session_id: str, after: int) -> AsyncGenerator[Event]:
        """Yields the events of one connection; raises `DeadlineExceeded` after `QUIET` seconds without one."""
