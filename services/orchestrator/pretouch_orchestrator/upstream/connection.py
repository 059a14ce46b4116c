"""One service that the orchestrator calls over gRPC: deadlines, retries, and errors that its own clients understand."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Awaitable, Callable
from typing import Any, TypeVar

import grpc
import grpc.aio
import structlog
from grpc_health.v1 import health_pb2, health_pb2_grpc

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
"""s: how long a call is tried again while its service is away or busy; a restarted copy is back by then."""
_FIRST_PAUSE, _LONGEST_PAUSE = 0.05, 1.0
_HEALTH_DEADLINE = 2.0
_LOGGED_IDS = (("session", SESSION_ID_METADATA), ("scan", SCAN_ID_METADATA))


class Upstream:
    """A service at `address`, reached by `channel`; `name` is what errors call it."""

    def __init__(self, name: str, address: str, channel: grpc.aio.Channel) -> None:
        self.name = name
        self.channel = channel
        self._address = address
        self._health = health_pb2_grpc.HealthStub(channel)

    async def call(self, method: Callable[..., Awaitable[Answer]], request: Any, deadline: float) -> Answer:
        """The answer of a unary `method`, within `deadline` seconds, all tries together.

        The session and scan that the log's context names travel as metadata.

        Raises:
            Unavailable: the service stays away for PATIENCE seconds.
            DeadlineExceeded: it took the call but did not answer in time.
            PretouchError: what the service itself found wrong.
        """
        context = structlog.contextvars.get_contextvars()
        metadata = [(key, str(context[name])) for name, key in _LOGGED_IDS if name in context]
        now = asyncio.get_running_loop().time
        started, pause = now(), _FIRST_PAUSE
        while True:
            try:
                return await method(request, timeout=started + deadline - now(), metadata=metadata)
            except grpc.aio.AioRpcError as failure:
                passing = isinstance(from_rpc_error(failure), Unavailable | Overloaded)
                if not passing or now() + pause > started + min(PATIENCE, deadline):
                    raise self._explained(failure, deadline) from failure
            await asyncio.sleep(pause * random.uniform(0.5, 1.0))
            pause = min(2 * pause, _LONGEST_PAUSE)

    async def check(self) -> None:
        """Raises `Unavailable` unless the service says that it serves."""
        try:
            answer = await self._health.Check(health_pb2.HealthCheckRequest(), timeout=_HEALTH_DEADLINE)
        except grpc.aio.AioRpcError as failure:
            raise self._explained(failure, _HEALTH_DEADLINE) from failure
        if answer.status != health_pb2.HealthCheckResponse.SERVING:
            raise Unavailable(f"The {self.name} at {self._address} is not ready.", "Wait, or look at its log.")

    def _explained(self, failure: grpc.aio.AioRpcError, deadline: float) -> PretouchError:
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
                "Start it or wait, then repeat the request: it has changed nothing yet.",
            )
        if isinstance(error, DeadlineExceeded):
            return DeadlineExceeded(
                f"The {self.name} at {self._address} did not answer within {deadline:g} s.",
                "Repeat the request: it has changed nothing yet; look at that service's load.",
            )
        return error
