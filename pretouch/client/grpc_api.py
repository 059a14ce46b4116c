"""The session API over gRPC: calls as protobuf messages."""

from __future__ import annotations

import uuid
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from google.protobuf.message import Message

from pretouch.calibrated_camera import CalibratedCamera, CameraSummary
from pretouch.client.api import Call, ResultT, SessionApi, SessionPage
from pretouch.client.arguments import check_id, check_key
from pretouch.client.images import ImageLike, load_depth, load_mask
from pretouch.errors import Conflict, Internal, InvalidInput
from pretouch.session import ScanPlan, ScanProgress, Session, SessionRequest, Submission, Telling
from pretouch.v1 import calibrated_camera_pb2 as camera_pb
from pretouch.v1 import orchestrator_pb2 as pb
from pretouch.wire.calibrated_camera import camera_from_proto, camera_summary_from_proto
from pretouch.wire.session import (
    progress_from_proto,
    request_to_proto,
    session_from_proto,
    submission_to_proto,
    telling_to_proto,
)

GRPC_ADDRESS = "127.0.0.1:50050"


@dataclass(frozen=True)
class RpcMessage:
    """A request, and the method of the OrchestratorService that it is for."""

    method: str
    request: Message


class GrpcSessionApi(SessionApi[RpcMessage, Any]):
    """The OrchestratorService, version 1."""

    def create_session(
        self, request: SessionRequest, depth: ImageLike, mask: ImageLike | None, idempotency_key: str | None
    ) -> Call[RpcMessage, Any, Session]:
        message = request_to_proto(
            request,
            load_depth(depth),
            None if mask is None else load_mask(mask),
            check_key(idempotency_key) or uuid.uuid4().hex,
        )
        return Call(RpcMessage("CreateSession", message), _decode_session)

    def session(self, session_id: str) -> Call[RpcMessage, Any, Session]:
        return Call(
            RpcMessage("GetSession", pb.GetSessionRequest(session_id=check_id("session", session_id))), _decode_session
        )

    def sessions(self, limit: int, cursor: str) -> Call[RpcMessage, Any, SessionPage]:
        message = pb.ListSessionsRequest(limit=limit, cursor=cursor)
        return Call(RpcMessage("ListSessions", message), _decode_page)

    def next_scan(self, session_id: str) -> Call[RpcMessage, Any, ScanPlan]:
        def decode_plan(answer: pb.GetSessionResponse) -> ScanPlan:
            session = _decode_session(answer)
            if session.next_scan is None:
                raise Conflict(
                    f"The session is {session.state}; it has no next scan.", "Create another session to scan on."
                )
            return session.next_scan

        return Call(
            RpcMessage("GetSession", pb.GetSessionRequest(session_id=check_id("session", session_id))), decode_plan
        )

    def submit(self, session_id: str, scan_id: str, submission: Submission) -> Call[RpcMessage, Any, Session]:
        message = submission_to_proto(check_id("session", session_id), check_id("scan", scan_id), submission)
        return Call(RpcMessage("SubmitScan", message), _decode_session)

    def tell(self, session_id: str, scan_id: str, telling: Telling) -> Call[RpcMessage, Any, ScanProgress]:
        message = telling_to_proto(check_id("session", session_id), check_id("scan", scan_id), telling)
        return Call(RpcMessage("TellSamples", message), _decode_progress)

    def cancel(self, session_id: str, purge: bool) -> Call[RpcMessage, Any, None]:
        request = pb.CancelSessionRequest(session_id=check_id("session", session_id), purge=purge)
        return Call(RpcMessage("CancelSession", request), lambda _: None)

    def cameras(self) -> Call[RpcMessage, Any, tuple[CameraSummary, ...]]:
        return Call(RpcMessage("ListCameras", camera_pb.ListCamerasRequest()), _decode_cameras)

    def camera(self, camera_id: str) -> Call[RpcMessage, Any, CalibratedCamera]:
        request = camera_pb.GetCameraRequest(camera_id=check_id("camera", camera_id))
        return Call(RpcMessage("GetCamera", request), _decode_camera)

    def forget_camera(self, camera_id: str) -> Call[RpcMessage, Any, None]:
        request = camera_pb.ForgetCameraRequest(camera_id=check_id("camera", camera_id))
        return Call(RpcMessage("ForgetCamera", request), lambda _: None)


def _decode_session(answer: Any) -> Session:
    return _decode(lambda: session_from_proto(answer.session))


def _decode_progress(answer: pb.TellSamplesResponse) -> ScanProgress:
    return _decode(lambda: progress_from_proto(answer.progress))


def _decode_page(answer: pb.ListSessionsResponse) -> SessionPage:
    return _decode(lambda: SessionPage(tuple(map(session_from_proto, answer.sessions)), answer.next))


def _decode_cameras(answer: camera_pb.ListCamerasResponse) -> tuple[CameraSummary, ...]:
    return _decode(lambda: tuple(map(camera_summary_from_proto, answer.cameras)))


def _decode_camera(answer: camera_pb.GetCameraResponse) -> CalibratedCamera:
    return _decode(lambda: camera_from_proto(answer.camera))


def _decode(parse: Callable[[], ResultT]) -> ResultT:
    try:
        return parse()
    except InvalidInput as error:
        raise Internal(
            f"The answer cannot be read: {error.detail}",
            "Check that the address is that of a pretouch orchestrator, and that the client is as new.",
        ) from error
