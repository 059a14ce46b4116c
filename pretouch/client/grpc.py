"""The gRPC clients, synchronous and asynchronous."""

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
from pretouch.client.grpc_api import GrpcSessionApi, RpcMessage
from pretouch.client.retries import TIMEOUT
from pretouch.client.synchronous import SyncClient
from pretouch.errors import from_rpc_error
from pretouch.v1 import orchestrator_pb2 as pb
from pretouch.v1.orchestrator_pb2_grpc import OrchestratorServiceStub

GRPC_ADDRESS = "127.0.0.1:50050"


def _as_path(path: str | PathLike[str] | None) -> Path | None:
    return None if path is None else Path(path)


class GrpcClient(SyncClient[RpcMessage, Any]):
    """A synchronous client of the orchestrator over gRPC.

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
        tls_ca: str | PathLike[str] | None = None,
        tls_cert: str | PathLike[str] | None = None,
        tls_key: str | PathLike[str] | None = None,
        timeout: float = TIMEOUT,
    ) -> None:
        super().__init__(GrpcSessionApi(), timeout)
        self._channel = open_sync_channel(address, token, _as_path(tls_ca), _as_path(tls_cert), _as_path(tls_key))
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
                yield Event.parse(message.id, message.type, message.data)
        except grpc.RpcError as error:
            raise from_rpc_error(error) from error
        finally:
            call.cancel()


class AsyncGrpcClient(AsyncClient[RpcMessage, Any]):
    """An asynchronous client of the orchestrator over gRPC; arguments as for `GrpcClient`.

    Create it in the event loop that it is used in.
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
        super().__init__(GrpcSessionApi(), timeout)
        self._channel = open_channel(address, token, _as_path(tls_ca), _as_path(tls_cert), _as_path(tls_key))
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
                yield Event.parse(message.id, message.type, message.data)
        except grpc.RpcError as error:
            raise from_rpc_error(error) from error
        finally:
            call.cancel()
