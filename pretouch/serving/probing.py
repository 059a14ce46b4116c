"""Finds out that a service hangs: it no longer answers its health check."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import grpc
import grpc.aio
from grpc_health.v1 import health_pb2, health_pb2_grpc


@dataclass(frozen=True)
class Probing:
    """How a service is asked whether it still answers.

    A service is busy rather than hung while its event loop gets a turn now and then: it is given three times five
    seconds for that.

    Attributes:
        every: s between two health checks.
        timeout: s in which a check must be answered.
        misses: so many checks in a row without an answer mean that the service hangs.
    """

    every: float = 2.0
    timeout: float = 5.0
    misses: int = 3


PATIENT = Probing()


async def wait_until_hung(socket: Path, probing: Probing, on_serving: Callable[[], None]) -> str:
    """Returns once the service that answers health checks at this Unix socket hangs; what was seen.

    An answer is an answer, whatever it says: a service that drains says that it does not serve.

    Args:
        on_serving: called whenever the service says that it serves.
    """
    misses = 0
    async with grpc.aio.insecure_channel(f"unix:{socket}") as channel:
        health = health_pb2_grpc.HealthStub(channel)
        while misses < probing.misses:
            await asyncio.sleep(probing.every)
            try:
                answer = await health.Check(health_pb2.HealthCheckRequest(), timeout=probing.timeout)
                misses = 0
                if answer.status == health_pb2.HealthCheckResponse.SERVING:
                    on_serving()
            except grpc.aio.AioRpcError:
                misses += 1
    return f"left {misses} health checks in a row unanswered"
