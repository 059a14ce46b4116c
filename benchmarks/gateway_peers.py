"""The peers of the gateway's benchmark: a bare pyserial reader, and a bare gRPC stream."""

from __future__ import annotations

import asyncio
import select
import time
from array import array
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import grpc.aio
import numpy as np
import serial
from numpy.typing import NDArray
from pretouch_sensor_gateway.range_batch import RangeBatch
from pretouch_sensor_gateway.wire_formats.binary import FrameDecoder

from benchmarks.gateway_fingers import MODULES
from benchmarks.gateway_inbox import Inbox
from pretouch.v1 import sensor_gateway_pb2 as pb

_METHOD = "/benchmark.Bare/Stream"
_LOOK = 0.2
"""Seconds without a byte after which a reader asks itself whether any more will come."""


@dataclass(frozen=True)
class Reading:
    """Read `count` frames in all, the first of which is due at `start`, ns of the steady clock.

    After `patience` s without a byte no more will come.
    """

    count: int
    start: int
    patience: float = 5.0
    decode: bool = False


@dataclass(frozen=True)
class Yielding:
    """Yield `count` messages on each stream at `rate`, one stream after the other, the first `phase` s after `start`,
    ns of the steady clock."""

    count: int
    rate: float
    start: int
    phase: float = 0.0


def read_ports(connection: Connection, ports: Sequence[str]) -> None:
    """A process that reads ports and answers each `Reading` with the ns of the steady clock at which frames came.

    One port is read blocking, of several those that have something.
    """
    with ExitStack() as stack:
        lines = [stack.enter_context(serial.Serial(port, timeout=_LOOK)) for port in ports]
        connection.send(None)
        while (reading := connection.recv()) is not None:
            connection.send(_read(lines, reading))


def _read(lines: Sequence[Any], reading: Reading) -> NDArray[np.int64]:
    stamps, decoder = array("q"), FrameDecoder()
    heard = reading.start
    while len(stamps) < reading.count:
        for line in lines if len(lines) == 1 else select.select(lines, [], [], _LOOK)[0]:
            data = line.read(line.in_waiting or 1)
            now = time.monotonic_ns()
            if data:
                heard = now
            frames = len(decoder.feed(data)) if reading.decode else data.count(0)
            stamps.extend([now] * frames)
        if time.monotonic_ns() - heard > reading.patience * 1e9:
            break
    return np.array(stamps)


def serve_streams(connection: Connection) -> None:
    """A process with a bare gRPC server; tells its port, and does each `Yielding` on all streams that are open."""
    asyncio.run(_serve_streams(connection))


async def _serve_streams(connection: Connection) -> None:
    jobs: list[asyncio.Queue[Yielding]] = []
    padding = bytes(message_size() - 8)

    async def stream(request: bytes, context: Any) -> Any:
        todo: asyncio.Queue[Yielding] = asyncio.Queue()
        number = len(jobs)
        jobs.append(todo)
        await context.send_initial_metadata(())
        while True:
            job = await todo.get()
            first = job.start * 1e-9 + job.phase + number / len(jobs) / job.rate
            for k in range(job.count):
                await asyncio.sleep(first + k / job.rate - time.monotonic())
                yield time.monotonic_ns().to_bytes(8, "little") + padding

    server = grpc.aio.server()
    handlers = {"Stream": grpc.unary_stream_rpc_method_handler(stream)}
    server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler("benchmark.Bare", handlers),))
    port = server.add_insecure_port("127.0.0.1:0")
    await server.start()
    connection.send(port)
    while (job := await asyncio.to_thread(connection.recv)) is not None:
        for todo in jobs:
            todo.put_nowait(job)
    await server.stop(0)


def take_streams(connection: Connection, port: int, count: int) -> None:
    """A process that reads `count` bare streams; answers as `gateway_subscriber` does, with keys of ns at yielding."""
    asyncio.run(_take_streams(connection, port, count))


async def _take_streams(connection: Connection, port: int, count: int) -> None:
    inboxes = [Inbox("q") for _ in range(count)]

    async def read(call: Any, inbox: Inbox) -> None:
        async for message in call:
            stamp = time.monotonic_ns()
            inbox.add(message[:8], stamp)

    async with grpc.aio.insecure_channel(f"127.0.0.1:{port}") as channel, asyncio.TaskGroup() as tasks:
        calls = [channel.unary_stream(_METHOD)(b"") for _ in inboxes]
        for call in calls:
            await call.wait_for_connection()
        readers = [tasks.create_task(read(call, inbox)) for call, inbox in zip(calls, inboxes, strict=True)]
        connection.send(None)
        while (command := await asyncio.to_thread(connection.recv)) is not None:
            connection.send(await asyncio.gather(*(inbox.take(*command) for inbox in inboxes)))
        for reader in readers:
            reader.cancel()


def message_size() -> int:
    """Bytes of the gateway's message of one frame."""
    ranges, codes = np.zeros((1, MODULES)), np.zeros((1, MODULES), dtype=np.uint8)
    sequence = np.zeros(1, dtype=np.uint32)
    batch = RangeBatch(np.ones(1), 1e-4, sequence, 1, ranges, ranges, codes, codes, 0, ranges.astype(np.float32))
    return int(pb.StreamRangesResponse(batch=batch.message).ByteSize())
