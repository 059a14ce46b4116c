"""The gRPC contract: a servicer over the session manager."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable
from contextlib import aclosing
from typing import Any, TypeVar

from google.protobuf.message import Message

from pretouch.errors import InvalidInput
from pretouch.serving import ServiceContext
from pretouch.serving.caller import current_caller
from pretouch.session import ScanProgress, Session
from pretouch.v1 import calibrated_camera_pb2 as camera_pb
from pretouch.v1 import orchestrator_pb2 as pb
from pretouch.v1 import orchestrator_pb2_grpc
from pretouch.wire.calibrated_camera import camera_summary_to_proto, camera_to_proto
from pretouch.wire.session import (
    progress_to_proto,
    request_from_proto,
    session_to_proto,
    submission_from_proto,
    telling_from_proto,
)
from pretouch_orchestrator.sessions.manager import DEFAULT_PAGE, SessionManager

T = TypeVar("T")
_SHORT = 256 * 1024
"""Bytes of a message that takes milliseconds to decode."""
SERVICE = pb.DESCRIPTOR.services_by_name["OrchestratorService"].full_name


class OrchestratorServicer(orchestrator_pb2_grpc.OrchestratorServiceServicer):
    """See orchestrator.proto. Errors are raised here and converted to gRPC statuses by `pretouch.serving`."""

    def __init__(self, sessions: SessionManager, context: ServiceContext) -> None:
        self._sessions = sessions
        self._context = context

    async def CreateSession(self, request: pb.CreateSessionRequest, context: Any) -> pb.CreateSessionResponse:
        return pb.CreateSessionResponse(session=session_to_proto(await self._create(request)))

    async def GetSession(self, request: pb.GetSessionRequest, context: Any) -> pb.GetSessionResponse:
        return pb.GetSessionResponse(
            session=session_to_proto(await self._sessions.get(current_caller().owner, request.session_id))
        )

    async def ListSessions(self, request: pb.ListSessionsRequest, context: Any) -> pb.ListSessionsResponse:
        limit = request.limit if request.HasField("limit") else DEFAULT_PAGE
        sessions, following = await self._sessions.list_page(current_caller().owner, limit, request.cursor)
        return pb.ListSessionsResponse(sessions=map(session_to_proto, sessions), next=following)

    async def SubmitScan(self, request: pb.SubmitScanRequest, context: Any) -> pb.SubmitScanResponse:
        return pb.SubmitScanResponse(session=session_to_proto(await self._submit(request.session_id, request)))

    async def TellSamples(self, request: pb.TellSamplesRequest, context: Any) -> pb.TellSamplesResponse:
        return pb.TellSamplesResponse(progress=progress_to_proto(await self._tell(request.session_id, request)))

    async def CancelSession(self, request: pb.CancelSessionRequest, context: Any) -> pb.CancelSessionResponse:
        session = await self._sessions.cancel(current_caller().owner, request.session_id, request.purge)
        return pb.CancelSessionResponse(session=session_to_proto(session))

    async def StreamEvents(
        self, request: pb.StreamEventsRequest, context: Any
    ) -> AsyncIterator[pb.StreamEventsResponse]:
        async with aclosing(self._sessions.follow(current_caller().owner, request.session_id, request.after)) as events:
            async for event in events:
                if event is not None:
                    yield pb.StreamEventsResponse(id=event.id, type=event.type, data=json.dumps(event.data))

    async def RunSession(
        self, requests: AsyncIterator[pb.RunSessionRequest], context: Any
    ) -> AsyncIterator[pb.RunSessionResponse]:
        session: Session | None = None
        async for request in _take_until(self._context.draining, requests):
            if session is not None and request.WhichOneof("step") == "samples":
                _check_session(request.samples.session_id, session.id)
                progress = await self._tell(session.id, request.samples)
                yield pb.RunSessionResponse(progress=progress_to_proto(progress))
                continue
            session = await self._step(request, session)
            yield pb.RunSessionResponse(session=session_to_proto(session))
            if session.state.ended:
                return

    async def ListCameras(self, request: camera_pb.ListCamerasRequest, context: Any) -> camera_pb.ListCamerasResponse:
        cameras = await self._sessions.cameras.list(current_caller().owner)
        return camera_pb.ListCamerasResponse(cameras=map(camera_summary_to_proto, cameras))

    async def GetCamera(self, request: camera_pb.GetCameraRequest, context: Any) -> camera_pb.GetCameraResponse:
        camera = await self._sessions.cameras.get(current_caller().owner, request.camera_id)
        return camera_pb.GetCameraResponse(camera=camera_to_proto(camera))

    async def ForgetCamera(
        self, request: camera_pb.ForgetCameraRequest, context: Any
    ) -> camera_pb.ForgetCameraResponse:
        await self._sessions.cameras.forget(current_caller().owner, request.camera_id)
        return camera_pb.ForgetCameraResponse()

    async def _step(self, request: pb.RunSessionRequest, session: Session | None) -> Session:
        match request.WhichOneof("step"):
            case "create" if session is None:
                return await self._create(request.create)
            case "session_id" if session is None:
                return await self._sessions.get(current_caller().owner, request.session_id)
            case "scan" if session is not None:
                _check_session(request.scan.session_id, session.id)
                return await self._submit(session.id, request.scan)
            case step:
                raise InvalidInput(
                    f"The stream's step is {step or 'empty'}, which is not allowed here.",
                    "Send `create` or `session_id` first, then scans and samples.",
                )

    async def _create(self, request: pb.CreateSessionRequest) -> Session:
        self._sessions.check_room()
        wanted, values, mask = await self._context.run_in_thread(request_from_proto, request)
        return await self._sessions.create(
            current_caller().owner, wanted, values, mask, request.idempotency_key or None
        )

    async def _submit(self, session_id: str, request: pb.SubmitScanRequest) -> Session:
        return await self._sessions.submit(
            current_caller().owner,
            session_id,
            request.scan_id,
            lambda: self._decode(submission_from_proto, request),
        )

    async def _tell(self, session_id: str, request: pb.TellSamplesRequest) -> ScanProgress:
        return await self._sessions.tell(
            current_caller().owner,
            session_id,
            request.scan_id,
            lambda: self._decode(telling_from_proto, request),
        )

    async def _decode(self, decode: Callable[[Any], T], request: Message) -> T:
        """A short message does not wait behind images."""
        run = self._context.run_briefly if request.ByteSize() <= _SHORT else self._context.run_in_thread
        return await run(decode, request)


def _check_session(named: str, running: str) -> None:
    """Raises `InvalidInput` unless a stream's step names no session or the one that the stream runs."""
    if named not in ("", running):
        raise InvalidInput(
            f"The step is for session {named!r:.80}; this stream runs {running!r}.",
            "Leave session_id empty, or open another stream.",
        )


async def _take_until(stop: asyncio.Event, requests: AsyncIterator[pb.RunSessionRequest]) -> AsyncIterator[Any]:
    """Yields the requests until `stop` is set."""
    stopped = asyncio.create_task(stop.wait())
    try:
        while True:
            following = asyncio.ensure_future(anext(requests, None))
            await asyncio.wait((stopped, following), return_when=asyncio.FIRST_COMPLETED)
            if not following.done():
                following.cancel()
                return
            if (request := following.result()) is None:
                return
            yield request
    finally:
        stopped.cancel()
