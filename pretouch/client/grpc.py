"""The orchestrator over gRPC."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Iterator
from os import PathLike
from pathlib import Path
from typing import Any

import grpc
import grpc.aio

from pretouch.channel import open_channel, open_sync_channel
from pretouch.client.asynchronous import AsyncClient
from pretouch.client.events import QUIET, Event
from pretouch.client.grpc_calls import GrpcCalls, RpcMessage
from pretouch.client.synchronous import SyncClient
from pretouch.errors import from_rpc_error
from pretouch.v1 import orchestrator_pb2 as pb
from pretouch.v1.orchestrator_pb2_grpc import OrchestratorServiceStub

GRPC_ADDRESS = "127.0.0.1:50050"
TIMEOUT = 60.0


def _path(path: str | PathLike[str] | None) -> Path | None:
    return None if path is None else Path(path)


class GrpcClient(SyncClient[RpcMessage, Any]):
    """The orchestrator over gRPC.

    Args:
        address: `host:port`.
        token: the bearer token, where one is set.
        tls_ca: PEM file of the authority to trust; without it the connection is not encrypted.
        tls_cert, tls_key: PEM files of this client's own certificate, where the server asks for one.
        timeout: s for a whole call, tries included.
    """

    def __init__(
        self,
        address: str = GRPC_ADDRESS,
        *,
        token: str | None = None,
        tls_ca: str | PathLike[str] | None = None,
        tls_cert: str | PathLike[str] | None = None,
        tls_key: str | PathLike[str] | None = None,
        timeout: float = TIMEOUT,
    ) -> None:
        super().__init__(GrpcCalls(), timeout)
        self._channel = open_sync_channel(address, token, _path(tls_ca), _path(tls_cert), _path(tls_key))
        self._stub = OrchestratorServiceStub(self._channel)

    def close(self) -> None:
        self._channel.close()

    def _send(self, message: RpcMessage, seconds: float) -> Any:
        try:
            return getattr(self._stub, message.method)(message.request, timeout=seconds)
        except grpc.RpcError as error:
            raise from_rpc_error(error) from error

    def _listen(self, session_id: str, after: int) -> Iterator[Event]:
        call = self._stub.StreamEvents(pb.StreamEventsRequest(session_id=session_id, after=after), timeout=QUIET)
        try:
            for message in call:
                yield Event.of(message.id, message.type, message.data)
        except grpc.RpcError as error:
            raise from_rpc_error(error) from error
        finally:
            call.cancel()


class AsyncGrpcClient(AsyncClient[RpcMessage, Any]):
    """As `GrpcClient`, for asyncio; make it where the event loop runs."""

    def __init__(
        self,
        address: str = GRPC_ADDRESS,
        *,
        token: str | None = None,
        tls_ca: str | PathLike[str] | None = None,
        tls_cert: str | PathLike[str] | None = None,
        tls_key: str | PathLike[str] | None = None,
        timeout: float = TIMEOUT,
    ) -> None:
        super().__init__(GrpcCalls(), timeout)
        self._channel = open_channel(address, token, _path(tls_ca), _path(tls_cert), _path(tls_key))
        self._stub = OrchestratorServiceStub(self._channel)

    async def close(self) -> None:
        await self._channel.close()

    async def _send(self, message: RpcMessage, seconds: float) -> Any:
        try:
            return await getattr(self._stub, message.method)(message.request, timeout=seconds)
        except grpc.RpcError as error:
            raise from_rpc_error(error) from error

    async def _listen(self, session_id: str, after: int) -> AsyncGenerator[Event]:
        call = self._stub.StreamEvents(pb.StreamEventsRequest(session_id=session_id, after=after), timeout=QUIET)
        try:
            async for message in call:
                yield Event.of(message.id, message.type, message.data)
        except grpc.RpcError as error:
            raise from_rpc_error(error) from error
        finally:
            call.cancel()
