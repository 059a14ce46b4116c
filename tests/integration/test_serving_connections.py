"""What gRPC's connections may do: pings of clients, proxies of the environment, large metadata, silence."""

from __future__ import annotations

import asyncio
import contextlib
import subprocess
import sys

import grpc
import grpc.aio
import pytest
from google.protobuf.wrappers_pb2 import StringValue
from helpers.serving_probe import Stub, running

from pretouch.channel import open_channel, open_sync_channel
from pretouch.serving import Settings, server, started

TIMEOUT = 20
NOWHERE = "http://127.0.0.1:9"


async def test_a_client_may_ping_on_a_quiet_stream() -> None:
    every_second = (
        ("grpc.keepalive_time_ms", 1_200),
        ("grpc.keepalive_permit_without_calls", 1),
        ("grpc.http2.max_pings_without_data", 0),
    )
    async with (
        started("probe", running, Settings()) as service,
        grpc.aio.insecure_channel(f"127.0.0.1:{service.port}", every_second) as channel,
    ):
        echo = Stub(channel).echoed(timeout=TIMEOUT)
        await echo.write(StringValue(value="one"))
        assert (await echo.read()).value == "one"
        await asyncio.sleep(6.0)  # five pings; the third was one too many
        await echo.write(StringValue(value="two"))
        assert (await echo.read()).value == "two"
        await echo.done_writing()
        assert await echo.read() is grpc.aio.EOF


@pytest.mark.parametrize("variable", ["http_proxy", "https_proxy", "grpc_proxy", "all_proxy"])
async def test_a_proxy_of_the_environment_is_not_asked(variable: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("no_proxy", "no_grpc_proxy"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv(variable, NOWHERE)

    def ask(port: int) -> str:
        with open_sync_channel(f"127.0.0.1:{port}") as channel:
            return Stub(channel).unary(StringValue(value="hello"), timeout=TIMEOUT).value

    async with started("probe", running, Settings()) as service:
        async with open_channel(f"127.0.0.1:{service.port}") as channel:
            assert (await Stub(channel).unary(StringValue(value="hello"), timeout=TIMEOUT)).value == "hello"
        assert await asyncio.to_thread(ask, service.port) == "hello"
        probe = [sys.executable, "-m", "pretouch", "healthcheck", f"127.0.0.1:{service.port}"]
        assert (await asyncio.to_thread(subprocess.run, probe, timeout=TIMEOUT, check=False)).returncode == 0


async def test_metadata_beyond_the_limit_is_refused_and_below_it_taken() -> None:
    async with (
        started("probe", running, Settings()) as service,
        open_channel(f"127.0.0.1:{service.port}") as channel,
    ):
        stub = Stub(channel)
        hello = StringValue(value="hello")
        assert (await stub.unary(hello, timeout=TIMEOUT, metadata=(("x", "a" * 12_000),))).value == "hello"
        with pytest.raises(grpc.aio.AioRpcError) as caught:
            await stub.unary(hello, timeout=TIMEOUT, metadata=(("x", "a" * 60_000),))
        assert caught.value.code() is grpc.StatusCode.RESOURCE_EXHAUSTED


async def test_connections_beyond_the_limit_are_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "get_connection_limit", lambda: 3)
    async with started("probe", running, Settings()) as service:
        held = [await asyncio.open_connection("127.0.0.1", service.port) for _ in range(6)]
        async with asyncio.timeout(TIMEOUT):
            ended = await asyncio.gather(*(_until_closed(reader) for reader, _ in held[3:]))
        assert ended == [True] * 3
        for _, writer in held:
            writer.close()


async def _until_closed(reader: asyncio.StreamReader) -> bool:
    with contextlib.suppress(ConnectionError):
        await reader.read()
    return True
