"""A gateway is followed over real gRPC, through its outages; what waiting would not mend is said at once."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress

import pytest
from helpers.watched_gateway import FakeGateway, device, ranges, status
from pretouch_sensor_gateway.watch import feed
from pretouch_sensor_gateway.watch.feed import Feed
from pretouch_sensor_gateway.watch.state import Watch

from pretouch.channel import open_channel
from pretouch.errors import InvalidInput, NotFound, Unauthenticated
from pretouch.v1.sensor_gateway_pb2_grpc import SensorGatewayServiceStub

TIMEOUT = 60.0  # of a whole test: only a hang takes so long
T0 = 1.7e9


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(feed, "STATUS_PERIOD", 0.02)
    monkeypatch.setattr(feed, "FIRST_DELAY", 0.02)
    monkeypatch.setattr(feed, "MAX_DELAY", 0.1)


@asynccontextmanager
async def fed(
    address: str, name: str = "", token: str | None = None
) -> AsyncIterator[tuple[Watch, asyncio.Task[None]]]:
    watch = Watch(address)
    async with asyncio.timeout(TIMEOUT), open_channel(address, token) as channel:
        task: asyncio.Task[None] = asyncio.create_task(Feed(SensorGatewayServiceStub(channel), watch, name).run())
        try:
            yield watch, task
        finally:
            task.cancel()
            with suppress(asyncio.CancelledError, InvalidInput, NotFound, Unauthenticated):
                await task


async def until(task: asyncio.Task[None], wanted: Callable[[], object]) -> None:
    while not wanted():
        if task.done():
            task.result()
        await asyncio.sleep(0.01)


async def test_status_and_ranges_of_all_devices_are_followed() -> None:
    with FakeGateway(status(device("thumb")), status(device("index"))) as gateway:
        async with fed(gateway.address) as (watch, task):
            for name in ("thumb", "index"):
                await asyncio.to_thread(gateway.send, name, ranges([T0], [[0.03, 0.04]]))
            await until(task, lambda: watch.devices and all(len(known.readings) == 2 for known in watch.devices))
            await until(task, lambda: all(known.status.epoch == 3 for known in watch.devices))
            assert [known.name for known in watch.devices] == ["thumb", "index"]
            gateway.statuses["index"] = status(device("index"), epoch=4)
            await until(task, lambda: watch.devices[1].status.epoch == 4)
            assert watch.connected


async def test_one_device_may_be_chosen() -> None:
    with FakeGateway(status(device("thumb")), status(device("index"))) as gateway:
        async with fed(gateway.address, "index") as (watch, task):
            await until(task, lambda: watch.devices)
            assert [known.name for known in watch.devices] == ["index"]


async def test_a_gateway_that_goes_away_is_found_again() -> None:
    with FakeGateway(status()) as gateway:
        async with fed(gateway.address) as (watch, task):
            await until(task, lambda: watch.devices and watch.devices[0].status.epoch == 3)
            finger = watch.devices[0]
            await asyncio.to_thread(gateway.stop)
            await until(task, lambda: not watch.connected)
            await until(task, lambda: "Connection refused" in watch.problem)
            assert watch.problem.startswith(f"No gateway answers at {gateway.address}: ")
            assert watch.retry_at > 0
            assert watch.devices == [finger], "what is known stays"
            gateway.start()
            await until(task, lambda: watch.connected)
            await asyncio.to_thread(gateway.send, "finger", ranges([T0], [[0.05]]))
            await until(task, lambda: finger.readings and finger.readings[0].range == 0.05)
            assert watch.events.last(1)[0].text.endswith("is back")


async def test_a_gateway_that_starts_later_is_waited_for() -> None:
    gateway = FakeGateway(status())
    with gateway:
        pass  # so that its port is known
    async with fed(gateway.address) as (watch, task):
        await until(task, lambda: watch.problem)
        assert not watch.heard
        with gateway:
            await until(task, lambda: watch.connected)


async def test_a_gateway_that_is_silent_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(feed, "TIMEOUT", 0.2)

    with socket.create_server(("127.0.0.1", 0)) as nobody:  # the system accepts, and no one ever reads
        address = f"127.0.0.1:{nobody.getsockname()[1]}"
        async with fed(address) as (watch, task):
            await until(task, lambda: watch.problem)
            assert watch.problem == f"The gateway at {address} did not answer within 0.2 s."


async def test_a_gateway_without_a_device_is_no_fault() -> None:
    with FakeGateway() as gateway:
        async with fed(gateway.address) as (watch, task):
            await until(task, lambda: watch.connected)
            gateway.statuses["finger"] = status()
            await until(task, lambda: watch.devices)


async def test_a_wrong_token_is_said_at_once() -> None:
    with FakeGateway(status(), token="secret") as gateway:
        async with fed(gateway.address, token="secret") as (watch, task):
            await until(task, lambda: watch.connected)
        for token in (None, "guess"):
            async with fed(gateway.address, token=token) as (_, task):
                with pytest.raises(Unauthenticated, match="token"):
                    await task


async def test_a_device_that_is_not_there_is_said_at_once() -> None:
    with FakeGateway(status(device("thumb")), status(device("index"))) as gateway:
        async with fed(gateway.address, "toe") as (_, task):
            with pytest.raises(NotFound, match="'toe'") as caught:
                await task
            assert "thumb, index" in caught.value.remedy


async def test_something_else_than_a_gateway_is_said_at_once(upstream_without_gateway: str) -> None:
    async with fed(upstream_without_gateway) as (_, task):
        with pytest.raises(InvalidInput, match="no sensor gateway"):
            await task


@pytest.fixture
async def upstream_without_gateway() -> AsyncIterator[str]:
    """A gRPC server that offers nothing."""
    import grpc.aio

    server = grpc.aio.server()
    port = server.add_insecure_port("127.0.0.1:0")
    await server.start()
    yield f"127.0.0.1:{port}"
    await server.stop(None)


async def test_a_message_that_is_none_is_said_at_once() -> None:
    broken = ranges([T0], [[0.03]])
    broken.batch.range.shape[0] = 9
    with FakeGateway(status()) as gateway:
        async with fed(gateway.address) as (_, task):
            await asyncio.to_thread(gateway.send, "finger", broken)
            with pytest.raises(InvalidInput, match="range has 8 bytes"):
                await task
