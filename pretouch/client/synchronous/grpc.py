# Generated from pretouch/client/asynchronous by `make client`: change that.
"""The gRPC client."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

from pretouch.channel import open_sync_channel
from pretouch.client.arguments import FilePath, as_path, check_id
from pretouch.client.events import QUIET, Event
from pretouch.client.grpc_api import GRPC_ADDRESS, GrpcSessionApi, RpcMessage
from pretouch.client.retries import TIMEOUT
from pretouch.client.rpc_errors import raising_rpc_errors
from pretouch.client.synchronous.client import SyncClient
from pretouch.tracing import propagated
from pretouch.v1 import orchestrator_pb2 as pb
from pretouch.v1.orchestrator_pb2_grpc import OrchestratorServiceStub


class GrpcClient(SyncClient[RpcMessage, Any]):
    """A client of the orchestrator over gRPC; an asynchronous one is opened in the event loop that it is used in.

    Args:
        address: `host:port`.
        token: the orchestrator's bearer token, if it requires one.
        tls_ca: PEM file of the certificate authority to trust; left out: the connection is not encrypted.
        tls_cert, tls_key: PEM files of this client's certificate, if the orchestrator requires one.
        timeout: s for a whole call, retries included.
    """

    def __init__(
        self,
        address: str = GRPC_ADDRESS,
        *,
        token: str | None = None,
        tls_ca: FilePath | None = None,
        tls_cert: FilePath | None = None,
        tls_key: FilePath | None = None,
        timeout: float = TIMEOUT,
    ) -> None:
        super().__init__(GrpcSessionApi(), timeout)
        self._channel = open_sync_channel(address, token, as_path(tls_ca), as_path(tls_cert), as_path(tls_key))
        self._stub = OrchestratorServiceStub(self._channel)

    def close(self) -> None:
        super().close()
        self._channel.close()

    def _send(self, message: RpcMessage, seconds: float) -> Any:
        with raising_rpc_errors():
            return getattr(self._stub, message.method)(
                message.request, timeout=seconds, metadata=tuple(propagated().items())
            )

    def _listen(self, session_id: str, after: int) -> Generator[Event]:
        request = pb.StreamEventsRequest(session_id=check_id("session", session_id), after=after)
        call = self._stub.StreamEvents(request, timeout=QUIET, metadata=tuple(propagated().items()))
        try:
            with raising_rpc_errors():
                for message in call:
                    yield Event.parse(message.id, message.type, message.data)
        finally:
            call.cancel()
