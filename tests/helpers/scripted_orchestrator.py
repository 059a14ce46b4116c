"""An orchestrator with scripted answers, over REST and gRPC, for tests of the clients."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from concurrent import futures
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import grpc

from helpers.unimplemented import unimplemented
from pretouch.errors import PROBLEM_METADATA_KEY, PretouchError, problem, wire_of
from pretouch.session import Session
from pretouch.v1 import orchestrator_pb2 as pb
from pretouch.v1 import orchestrator_pb2_grpc
from pretouch.wire.json import session_to_json
from pretouch.wire.session import session_to_proto


class ScriptedOrchestrator:
    """Answers `session` to every call, but first each of `errors`, once.

    Attributes:
        connections: batches of events (id, type); each event stream gets the next batch, then breaks off.
        calls: what came in: the REST method and path, or the RPC's name.
        keys: idempotency keys that came in.
        resumed: the `after` of each event stream.
    """

    def __init__(self, session: Session) -> None:
        self.session = session
        self.errors: list[PretouchError | bytes] = []
        self.connections: list[list[tuple[int, str]]] = []
        self.calls: list[str] = []
        self.keys: list[str] = []
        self.resumed: list[int] = []

    def __enter__(self) -> ScriptedOrchestrator:
        self._http = ThreadingHTTPServer(("127.0.0.1", 0), type("Handler", (_Handler,), {"script": self}))
        threading.Thread(target=self._http.serve_forever, args=(0.05,)).start()
        self._grpc = grpc.server(futures.ThreadPoolExecutor(8))
        orchestrator_pb2_grpc.add_OrchestratorServiceServicer_to_server(_Servicer(self), self._grpc)
        port = self._grpc.add_insecure_port("127.0.0.1:0")
        self._grpc.start()
        self.rest_url = f"http://127.0.0.1:{self._http.server_port}"
        self.grpc_address = f"127.0.0.1:{port}"
        return self

    def __exit__(self, *_: object) -> None:
        self._http.shutdown()
        self._http.server_close()
        self._grpc.stop(None).wait()

    def next_error(self, call: str) -> PretouchError | bytes | None:
        self.calls.append(call)
        return self.errors.pop(0) if self.errors else None


class _Handler(BaseHTTPRequestHandler):
    script: ScriptedOrchestrator

    def log_message(self, format: str, *args: Any) -> None:
        pass

    def _answer(self) -> None:
        self.rfile.read(int(self.headers.get("content-length", 0)))
        if "idempotency-key" in self.headers:
            self.script.keys.append(self.headers["idempotency-key"])
        error = self.script.next_error(f"{self.command} {self.path}")
        if isinstance(error, bytes):
            self._send(200, "text/html", error)
        elif error is not None:
            document = problem(error)
            self._send(document["status"], "application/problem+json", json.dumps(document).encode())
        elif self.path.endswith("/events"):
            after = int(self.headers.get("last-event-id", 0))
            self.script.resumed.append(after)
            batch = self.script.connections.pop(0)
            text = "".join(f'id: {id}\nevent: {type}\ndata: {{"n": {id}}}\n\n' for id, type in batch)
            self._send(200, "text/event-stream", b": hello\n\n" + text.encode())
        elif self.command == "DELETE":
            self._send(204, "text/plain", b"")
        else:
            self._send(200, "application/json", json.dumps(session_to_json(self.script.session)).encode())

    def _send(self, status: int, media_type: str, body: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", media_type)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    do_GET = do_POST = do_DELETE = _answer


class _Servicer(orchestrator_pb2_grpc.OrchestratorServiceServicer):
    ListSessions = RunSession = TellSamples = ListCameras = GetCamera = ForgetCamera = unimplemented

    def __init__(self, script: ScriptedOrchestrator) -> None:
        self._script = script

    def _enter(self, call: str, context: grpc.ServicerContext) -> pb.Session:
        error = self._script.next_error(call)
        if isinstance(error, bytes):
            return pb.Session()
        if error is not None:
            context.set_trailing_metadata(((PROBLEM_METADATA_KEY, json.dumps(problem(error)).encode()),))
            context.abort(wire_of(error).grpc_code, error.detail)
        return session_to_proto(self._script.session)

    def CreateSession(self, request: pb.CreateSessionRequest, context: Any) -> pb.CreateSessionResponse:
        self._script.keys.append(request.idempotency_key)
        return pb.CreateSessionResponse(session=self._enter("CreateSession", context))

    def GetSession(self, request: pb.GetSessionRequest, context: Any) -> pb.GetSessionResponse:
        return pb.GetSessionResponse(session=self._enter("GetSession", context))

    def SubmitScan(self, request: pb.SubmitScanRequest, context: Any) -> pb.SubmitScanResponse:
        return pb.SubmitScanResponse(session=self._enter("SubmitScan", context))

    def CancelSession(self, request: pb.CancelSessionRequest, context: Any) -> pb.CancelSessionResponse:
        return pb.CancelSessionResponse(session=self._enter("CancelSession", context))

    def StreamEvents(self, request: pb.StreamEventsRequest, context: Any) -> Iterator[pb.StreamEventsResponse]:
        self._enter("StreamEvents", context)
        self._script.resumed.append(request.after)
        for id, type in self._script.connections.pop(0):
            yield pb.StreamEventsResponse(id=id, type=type, data=json.dumps({"n": id}))
