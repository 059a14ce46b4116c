"""A served process: its ready line, its JSON log, and how it ends."""

from __future__ import annotations

import asyncio
import json
import signal
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import grpc
import pytest
from google.protobuf.wrappers_pb2 import StringValue
from grpc_health.v1 import health_pb2, health_pb2_grpc
from helpers.serving_probe import Stub

from pretouch.channel import open_channel
from pretouch.errors import Unavailable, from_rpc_error

TESTS = Path(__file__).parents[1]
TIMEOUT = 30


class Served:
    """A probe process, its log so far, and a client to it."""

    channel: grpc.aio.Channel
    stub: Stub

    def __init__(self, process: Process) -> None:
        self.process = process
        self.log: list[dict[str, Any]] = []

    async def line(self, event: str) -> dict[str, Any]:
        """The next line of the log with this event; every line must be JSON."""
        assert self.process.stderr is not None
        async with asyncio.timeout(TIMEOUT):
            while raw := await self.process.stderr.readline():
                self.log.append(json.loads(raw))
                if self.log[-1]["event"] == event:
                    return self.log[-1]
        raise AssertionError(f"no line {event!r} in {self.log}")

    async def ended(self) -> int:
        """The exit code, with the rest of the log read."""
        assert self.process.stderr is not None
        async with asyncio.timeout(TIMEOUT):
            self.log += [json.loads(raw) for raw in (await self.process.stderr.read()).splitlines()]
            return await self.process.wait()


@asynccontextmanager
async def served(*arguments: str) -> AsyncIterator[Served]:
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "helpers.serving_probe", *arguments, cwd=TESTS, stdin=PIPE, stderr=PIPE
    )
    try:
        probe = Served(process)
        port = (await probe.line("ready"))["port"]
        async with open_channel(f"127.0.0.1:{port}") as channel:
            probe.channel, probe.stub = channel, Stub(channel)
            yield probe
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()


def call(probe: Served, request: str) -> asyncio.Task[str]:
    async def value() -> str:
        return (await probe.stub.unary(StringValue(value=request), timeout=TIMEOUT)).value

    return asyncio.create_task(value())


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
async def test_a_signal_lets_a_running_call_end(number: signal.Signals) -> None:
    async with served("20") as probe:
        open_stream = probe.stub.until_draining(StringValue(), timeout=TIMEOUT)
        assert (await open_stream.read()).value == "open"
        held = call(probe, "outlast")
        assert await call(probe, "fence") == "fence"
        probe.process.send_signal(number)
        await probe.line("stopping")
        assert await held == "outlast"
        assert (await open_stream.read()).value == "draining"
        assert await probe.ended() == 0
        assert probe.log[-1]["event"] == "closed"


async def test_a_call_that_does_not_end_is_cut_off_after_the_grace() -> None:
    async with served("0.2") as probe:
        held = call(probe, "forever")
        assert await call(probe, "fence") == "fence"
        health = health_pb2_grpc.HealthStub(probe.channel)
        watch = health.Watch(health_pb2.HealthCheckRequest(), timeout=TIMEOUT)
        assert (await watch.read()).status == health_pb2.HealthCheckResponse.SERVING
        probe.process.send_signal(signal.SIGTERM)
        with pytest.raises(grpc.aio.AioRpcError) as caught:
            await held
        assert isinstance(from_rpc_error(caught.value), Unavailable)
        assert "stopped before the call ended" in str(caught.value.details())
        assert await probe.ended() == 0
        assert not [line for line in probe.log if line["level"] in ("error", "warning")]


async def test_a_second_signal_ends_it_at_once() -> None:
    async with served("1000") as probe:
        held = call(probe, "forever")
        assert await call(probe, "fence") == "fence"
        probe.process.send_signal(signal.SIGTERM)
        await probe.line("stopping")
        probe.process.send_signal(signal.SIGTERM)
        with pytest.raises(grpc.aio.AioRpcError):
            await held
        await probe.ended()


async def test_it_ends_when_its_parent_closes_standard_input() -> None:
    async with served("1", "--until-stdin-closes") as probe:
        assert probe.process.stdin is not None
        probe.process.stdin.close()
        assert await probe.ended() == 0


async def test_the_log_is_json_with_time_level_service_and_the_calls_ids() -> None:
    async with served("1") as probe:
        metadata = (("pretouch-session-id", "s1"), ("pretouch-scan-id", "k2"))
        await probe.stub.unary(StringValue(value="x"), metadata=metadata, timeout=TIMEOUT)
        line = await probe.line("call")
        assert {key: line[key] for key in ("service", "level", "session", "scan", "code", "method")} == {
            "service": "probe",
            "level": "info",
            "session": "s1",
            "scan": "k2",
            "code": "OK",
            "method": "test.Probe/Unary",
        }
        assert line["timestamp"].endswith("Z")
        with pytest.raises(grpc.aio.AioRpcError):
            await call(probe, "defect")
        defect = await probe.line("a call met a defect")
        assert defect["level"] == "error"
        assert "ZeroDivisionError: a secret of the inside" in defect["exception"]
        assert "\n" in defect["exception"], "the trace is one field of one line"
