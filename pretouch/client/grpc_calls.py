"""The orchestrator's calls over gRPC, as protobuf messages."""

from __future__ import annotations

import uuid
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from google.protobuf.message import Message

from pretouch.client.calls import Call, Calls, SessionPage, T
from pretouch.client.images import ImageLike, depth_values, mask_values
from pretouch.errors import Conflict, Internal, InvalidInput
from pretouch.session import ScanPlan, Session, SessionRequest, Submission
from pretouch.v1 import orchestrator_pb2 as pb
from pretouch.wire.session import request_to_proto, session_from_proto, submission_to_proto


@dataclass(frozen=True)
class RpcMessage:
    """A request and the name of the method of the OrchestratorService that takes it."""

    method: str
    request: Message


class GrpcCalls(Calls[RpcMessage, Any]):
    """The OrchestratorService, version 1."""

    def create_session(
        self, request: SessionRequest, depth: ImageLike, mask: ImageLike | None, idempotency_key: str | None
    ) -> Call[RpcMessage, Any, Session]:
        message = request_to_proto(
            request,
            depth_values(depth),
            None if mask is None else mask_values(mask),
            idempotency_key or uuid.uuid4().hex,
        )
        return Call(RpcMessage("CreateSession", message), _session)

    def session(self, session_id: str) -> Call[RpcMessage, Any, Session]:
        return Call(RpcMessage("GetSession", pb.GetSessionRequest(session_id=session_id)), _session)

    def sessions(self, limit: int, cursor: str) -> Call[RpcMessage, Any, SessionPage]:
        message = pb.ListSessionsRequest(limit=limit, cursor=cursor)
        return Call(RpcMessage("ListSessions", message), _page)

    def next_scan(self, session_id: str) -> Call[RpcMessage, Any, ScanPlan]:
        def plan(answer: pb.GetSessionResponse) -> ScanPlan:
            session = _session(answer)
            if session.next_scan is None:
                raise Conflict(
                    f"The session is {session.state}; it has no next scan.", "Create another session to scan on."
                )
            return session.next_scan

        return Call(RpcMessage("GetSession", pb.GetSessionRequest(session_id=session_id)), plan)

    def submit(self, session_id: str, scan_id: str, submission: Submission) -> Call[RpcMessage, Any, Session]:
        return Call(RpcMessage("SubmitScan", submission_to_proto(session_id, scan_id, submission)), _session)

    def cancel(self, session_id: str) -> Call[RpcMessage, Any, None]:
        return Call(RpcMessage("CancelSession", pb.CancelSessionRequest(session_id=session_id)), lambda _: None)


def _session(answer: Any) -> Session:
    return _readable(lambda: session_from_proto(answer.session))


def _page(answer: pb.ListSessionsResponse) -> SessionPage:
    return _readable(lambda: SessionPage(tuple(map(session_from_proto, answer.sessions)), answer.next))


def _readable(parse: Callable[[], T]) -> T:
    try:
        return parse()
    except InvalidInput as error:
        raise Internal(
            f"The answer cannot be read: {error.detail}",
            "Check that the address is that of a pretouch orchestrator, and that the client is as new.",
        ) from error
