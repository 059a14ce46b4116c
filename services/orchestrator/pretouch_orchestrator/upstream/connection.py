"""A gRPC connection to one copy of an upstream service: one call at a time, with errors fit for our own clients."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from typing import Any

import grpc
import grpc.aio
import structlog
from grpc_health.v1 import health_pb2, health_pb2_grpc

from pretouch.channel import SCAN_ID_METADATA, SESSION_ID_METADATA
from pretouch.errors import (
    PROBLEM_METADATA_KEY,
    DeadlineExceeded,
    PretouchError,
    RefusedForSize,
    TooLarge,
    Unauthenticated,
    Unavailable,
    from_rpc_error,
)
from pretouch.tracing import propagated, span

_HEALTH_DEADLINE = 3.0
_LOOK_AFTER = 2.0
"""s after which the service of a call without an answer is asked whether it still lives."""
_LOGGED_IDS = (("session", SESSION_ID_METADATA), ("scan", SCAN_ID_METADATA))


class Unreachable(Unavailable):
    """The copy cannot be reached, or does not live; another one may be asked instead."""


class RefusesToken(Unavailable):
    """The copy does not take the orchestrator's token, and neither will it a moment later."""


class UpstreamConnection:
    """The connection to the copy at `address`; errors refer to the service by `name`.

    Args:
        stub: of the generated code, over `channel`.
    """

    def __init__(self, name: str, address: str, channel: grpc.aio.Channel, stub: Any) -> None:
        self.address = address
        self._name = name
        self._channel = channel
        self._stub = stub
        self._health = health_pb2_grpc.HealthStub(channel)

    async def call(self, method: str, request: Any, deadline: float) -> Any:
        """The response of a unary method, within `deadline` seconds.

        The session and scan of the log context are sent as metadata. A copy that does not answer is asked for its
        health now and then, and the call ends when it does not live.

        Raises:
            Unreachable: the copy cannot be reached, or does not live.
            DeadlineExceeded: it accepted the call but did not respond in time.
            RefusedForSize: see there.
            PretouchError: the service's own error.
        """
        with span(f"{self._name} {method}", {"server.address": self.address}, client=True):
            return await self._call(method, request, deadline)

    async def _call(self, method: str, request: Any, deadline: float) -> Any:
        context = structlog.contextvars.get_contextvars()
        metadata = [(key, str(context[name])) for name, key in _LOGGED_IDS if name in context]
        call = getattr(self._stub, method)(request, timeout=deadline, metadata=[*metadata, *propagated().items()])
        answer = asyncio.ensure_future(call)
        try:
            while not (await asyncio.wait((answer,), timeout=_LOOK_AFTER))[0]:
                await self._check_health()
            return await answer
        except grpc.aio.AioRpcError as failure:
            raise self._explain(failure, deadline) from failure
        finally:
            answer.cancel()

    async def stream(self, method: str, request: Any) -> AsyncGenerator[Any]:
        """The responses of a streaming method, for as long as they are read.

        Args:
            request: the request, or an asynchronous iterator of them.

        Raises:
            PretouchError: as `call`.
        """
        call = getattr(self._stub, method)(request, metadata=list(propagated().items()))
        try:
            async for response in call:
                yield response
        except grpc.aio.AioRpcError as failure:
            raise self._explain(failure, _HEALTH_DEADLINE) from failure
        finally:
            call.cancel()

    async def check(self) -> None:
        """Raises `Unavailable` unless the copy reports that it serves."""
        if await self._check_health() != health_pb2.HealthCheckResponse.SERVING:
            raise Unavailable(f"The {self._name} at {self.address} is not ready.", "Wait, or read its log.")

    async def close(self) -> None:
        """Ends the connection, and the calls that still use it."""
        await self._channel.close()

    async def _check_health(self) -> int:
        """What the copy reports; raises `Unreachable` if it reports nothing."""
        try:
            answer = await self._health.Check(health_pb2.HealthCheckRequest(), timeout=_HEALTH_DEADLINE)
        except grpc.aio.AioRpcError as failure:
            error = self._explain(failure, _HEALTH_DEADLINE)
            raise Unreachable(error.detail, error.remedy) from failure
        return int(answer.status)

    def _explain(self, failure: grpc.aio.AioRpcError, deadline: float) -> PretouchError:
        error = from_rpc_error(failure)
        if isinstance(error, Unauthenticated):
            return RefusesToken(
                f"The {self._name} at {self.address} refuses the orchestrator's token.",
                "Start all services with the same token.",
            )
        if any(key == PROBLEM_METADATA_KEY for key, _ in failure.trailing_metadata() or ()):
            return error
        if failure.code() is grpc.StatusCode.INTERNAL:
            return error
        if isinstance(error, Unavailable):
            return Unreachable(
                f"The {self._name} at {self.address} cannot be reached.",
                "Start it or wait, then repeat the request: nothing was changed.",
            )
        if isinstance(error, DeadlineExceeded):
            return DeadlineExceeded(
                f"The {self._name} at {self.address} did not answer within {deadline:.3g} s.",
                "Repeat the request: nothing was changed. Check that service's load.",
            )
        if isinstance(error, TooLarge):
            return RefusedForSize(
                f"What the {self._name} would be sent is larger than a message may be.",
                "Open a new session with a cropped image, and send fewer samples.",
            )
        return error
