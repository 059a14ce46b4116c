"""The real sensor gateway within this process, and a client of it, for tests that inject faults."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable, MutableMapping
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Any

import grpc.aio
import structlog.testing
from pretouch_sensor_gateway.configuration import DeviceSetting, GatewaySetting
from pretouch_sensor_gateway.service import serve

from helpers.faulty_listener import Listener
from pretouch.channel import open_channel
from pretouch.serving import Settings, started
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.v1.sensor_gateway_pb2_grpc import SensorGatewayServiceStub

TIMEOUT = 60.0
"""Seconds; only a hang takes so long."""
_POLL = 0.01


class Gateway:
    """A client of a gateway, and of one of its devices.

    Attributes:
        port: of gRPC.
        log: what the gateway logged, where it runs in this process.
    """

    def __init__(self, port: int, stub: Any, log: list[MutableMapping[str, Any]], device: str = "") -> None:
        self.port = port
        self.stub = stub
        self.log = log
        self._device = device

    async def status(self) -> pb.GetStatusResponse:
        answer: pb.GetStatusResponse = await self.stub.GetStatus(pb.GetStatusRequest(device=self._device))
        return answer

    async def until(self, wanted: Callable[[pb.GetStatusResponse], bool]) -> pb.GetStatusResponse:
        """Polls until a status fulfils the condition, and returns it."""
        while not wanted(status := await self.status()):  # noqa: ASYNC110
            await asyncio.sleep(_POLL)
        return status

    async def opened(self, times: int = 1) -> None:
        """Waits until the port was opened so often, since a pty drops what was sent before."""
        await self.until(lambda status: status.connections >= times)

    @asynccontextmanager
    async def listening(self) -> AsyncIterator[Listener]:
        """A subscriber that receives everything from now on."""
        stream = self.stub.StreamRanges(pb.StreamRangesRequest(device=self._device))
        await stream.wait_for_connection()
        async with Listener(stream) as listener:
            yield listener

    def warnings(self) -> list[str]:
        return [entry["event"] for entry in self.log if entry["log_level"] == "warning"]


@asynccontextmanager
async def gateway(port: Path | GatewaySetting, device: str = "") -> AsyncIterator[Gateway]:
    """A gateway in this process, with one device on `port` or a whole setting; its log must not contain a defect."""
    setting = port if isinstance(port, GatewaySetting) else GatewaySetting((DeviceSetting("finger", str(port)),))
    with structlog.testing.capture_logs() as log:
        async with (
            asyncio.timeout(TIMEOUT),
            started("gateway", partial(serve, setting=setting), Settings(grace=1.0)) as service,
            client(service.port, log, device) as clients,
        ):
            yield clients
    assert not [entry for entry in log if entry["log_level"] in ("error", "critical")]


@asynccontextmanager
async def client(
    port: int, log: list[MutableMapping[str, Any]] | None = None, device: str = ""
) -> AsyncIterator[Gateway]:
    """A client of the gateway on that port of gRPC, once it is connected."""
    async with open_channel(f"127.0.0.1:{port}") as channel:
        await channel.channel_ready()
        yield Gateway(port, SensorGatewayServiceStub(channel), [] if log is None else log, device)


@asynccontextmanager
async def small_window(port: int) -> AsyncIterator[Gateway]:
    """A client whose side of the connection takes few bytes that it has not read: 64 KiB instead of megabytes."""
    options = (("grpc.http2.bdp_probe", 0), ("grpc.http2.lookahead_bytes", 65_536))
    async with grpc.aio.insecure_channel(f"127.0.0.1:{port}", options) as channel:
        yield Gateway(port, SensorGatewayServiceStub(channel), [])


def unix_offset() -> float:
    """By how much the Unix clock is ahead of `time.monotonic`, s."""
    while True:
        before, unix, after = time.monotonic(), time.time(), time.monotonic()
        if after - before < 1e-4:
            return unix - (before + after) / 2
