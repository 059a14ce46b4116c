"""A gRPC connection to one upstream service, with deadlines, retries, and errors fit for the orchestrator's clients."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any, TypeVar

import grpc
import grpc.aio
import structlog
from grpc_health.v1 import health_pb2, health_pb2_grpc

from pretouch.backoff import Backoff
from pretouch.channel import SCAN_ID_METADATA, SESSION_ID_METADATA
from pretouch.errors import (
    PROBLEM_METADATA_KEY,
    DeadlineExceeded,
    Overloaded,
    PretouchError,
    Unauthenticated,
    Unavailable,
    from_rpc_error,
)

Answer = TypeVar("Answer")

PATIENCE = 5.0
"""s: how long calls are retried while their service is unavailable or busy; enough for it to restart."""
_FIRST_DELAY, _MAX_DELAY, _JITTER = 0.05, 1.0, 0.5
_HEALTH_DEADLINE = 2.0
_LOGGED_IDS = (("session", SESSION_ID_METADATA), ("scan", SCAN_ID_METADATA))


class UpstreamConnection:
    """The connection to the service at `address`; errors refer to it by `name`."""

    def __init__(self, name: str, address: str, channel: grpc.aio.Channel) -> None:
        self.name = name
        self.channel = channel
        self._address = address
        self._health = health_pb2_grpc.HealthStub(channel)

    async def call(self, method: Callable[..., Awaitable[Answer]], request: Any, deadline: float) -> Answer:
        """The response of a unary `method`, within `deadline` seconds over all retries.

        The session and scan of the log context are sent as metadata.

        Raises:
            Unavailable: the service is unavailable for PATIENCE seconds.
            DeadlineExceeded: it accepted the call but did not respond in time.
            PretouchError: the service's own error.
        """
        context = structlog.contextvars.get_contextvars()
        metadata = [(key, str(context[name])) for name, key in _LOGGED_IDS if name in context]
        now = asyncio.get_running_loop().time
        started, backoff = now(), Backoff(_FIRST_DELAY, _MAX_DELAY, _JITTER)
        while True:
            try:
                return await method(request, timeout=started + deadline - now(), metadata=metadata)
            except grpc.aio.AioRpcError as failure:
                transient = isinstance(from_rpc_error(failure), Unavailable | Overloaded)
                delay = backoff.next_delay()
                if not transient or now() + delay > started + min(PATIENCE, deadline):
                    raise self._explain(failure, deadline) from failure
            await asyncio.sleep(delay)

    async def check(self) -> None:
        """Raises `Unavailable` unless the service reports that it serves."""
        try:
            answer = await self._health.Check(health_pb2.HealthCheckRequest(), timeout=_HEALTH_DEADLINE)
        except grpc.aio.AioRpcError as failure:
            raise self._explain(failure, _HEALTH_DEADLINE) from failure
        if answer.status != health_pb2.HealthCheckResponse.SERVING:
            raise Unavailable(f"The {self.name} at {self._address} is not ready.", "Wait, or read its log.")

    def _explain(self, failure: grpc.aio.AioRpcError, deadline: float) -> PretouchError:
        error = from_rpc_error(failure)
        if isinstance(error, Unauthenticated):
            return Unavailable(
                f"The {self.name} at {self._address} refuses the orchestrator's token.",
                "Start all services with the same token.",
            )
        if any(key == PROBLEM_METADATA_KEY for key, _ in failure.trailing_metadata() or ()):
            return error
        if isinstance(error, Unavailable):
            return Unavailable(
                f"The {self.name} at {self._address} cannot be reached.",
                "Start it or wait, then repeat the request: nothing was changed.",
            )
        if isinstance(error, DeadlineExceeded):
            return DeadlineExceeded(
                f"The {self.name} at {self._address} did not answer within {deadline:g} s.",
                "Repeat the request: nothing was changed. Check that service's load.",
            )
        return error
