"""A client of the gateway in a process of its own: StreamRanges of some devices on one channel."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from multiprocessing.connection import Connection
from typing import Any

from benchmarks.gateway_inbox import Inbox
from pretouch.channel import open_channel
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.v1.sensor_gateway_pb2_grpc import SensorGatewayServiceStub


def run(connection: Connection, address: str, devices: Sequence[str]) -> None:
    """The process: ready once it misses nothing; answers (count, patience) with what each stream got (`Received`)."""
    asyncio.run(_listen(connection, address, devices))


async def _listen(connection: Connection, address: str, devices: Sequence[str]) -> None:
    inboxes = [Inbox("I") for _ in devices]
    async with open_channel(address) as channel, asyncio.TaskGroup() as tasks:
        stub = SensorGatewayServiceStub(channel)
        calls = [stub.StreamRanges(pb.StreamRangesRequest(device=device)) for device in devices]
        for call in calls:
            await call.wait_for_connection()
        readers = [tasks.create_task(_read(call, inbox)) for call, inbox in zip(calls, inboxes, strict=True)]
        connection.send(None)
        while (command := await asyncio.to_thread(connection.recv)) is not None:
            connection.send(await asyncio.gather(*(inbox.take(*command) for inbox in inboxes)))
        for reader in readers:
            reader.cancel()


async def _read(call: Any, inbox: Inbox) -> None:
    async for response in call:
        stamp = time.monotonic_ns()
        inbox.add(response.batch.sequence.data, stamp, response.batch.lost + response.overrun)
