"""A service for `pretouch.serving`'s tests, with one method of each kind; as a program it serves itself."""

from __future__ import annotations

import argparse
import asyncio
import threading
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import grpc
import structlog
from google.protobuf.message import Message
from google.protobuf.wrappers_pb2 import BytesValue, StringValue

from pretouch import errors
from pretouch.cancellation import check_cancelled
from pretouch.serving import ServiceContext, Settings, serve

SERVICE = "test.Probe"
KINDS = {kind.__name__: kind for kind in errors.WIRE}


class Probe:
    """What a call asks for is its string: an error's name, `spin`, `job`, `wait`, or something to echo."""

    def __init__(self, context: ServiceContext) -> None:
        self._context = context
        self.release = threading.Event()

    async def unary(self, request: StringValue, context: Any) -> StringValue:
        match request.value.split(":"):
            case [name] if name in KINDS:
                raise KINDS[name](f"{name} happened", "do something else")
            case ["defect"]:
                raise ZeroDivisionError("a secret of the inside")
            case ["long"]:
                raise errors.InvalidInput("ä" * 100_000, "ö" * 100_000)
            case ["abort"]:
                await context.abort(grpc.StatusCode.DATA_LOSS, "by hand")
            case ["block"]:
                time.sleep(3600)  # noqa: ASYNC251 - the event loop's deadlock is what is wanted
            case ["forever"]:
                await asyncio.Event().wait()
            case ["spin", seconds]:
                await self._context.run_in_thread(_spin, float(seconds))
            case ["grind"]:
                await self._context.run_in_thread(_grind)
            case ["hold"]:
                await self._context.run_in_thread(self.release.wait, 30)
            case ["release"]:
                self.release.set()
            case ["outlast"]:
                await self._context.draining.wait()
                await asyncio.sleep(0.1)
            case ["wait", seconds]:
                await asyncio.sleep(float(seconds))
            case ["context"]:
                return StringValue(value=repr(structlog.contextvars.get_contextvars()))
        return StringValue(value=request.value)

    async def size(self, request: BytesValue, context: Any) -> StringValue:
        return StringValue(value=str(len(request.value)))

    async def bytes(self, request: StringValue, context: Any) -> BytesValue:
        return BytesValue(value=b"\0" * int(request.value))

    async def gathered(self, requests: AsyncIterator[StringValue], context: Any) -> StringValue:
        return StringValue(value=" ".join([request.value async for request in requests]))

    async def counted(self, request: StringValue, context: Any) -> AsyncIterator[StringValue]:
        for number in range(int(request.value)):
            yield StringValue(value=str(number))
        raise errors.NotFound("the end was asked for", "ask for less")

    async def until_draining(self, request: StringValue, context: Any) -> None:
        await context.write(StringValue(value="open"))
        await self._context.draining.wait()
        await context.write(StringValue(value="draining"))

    async def echoed(self, requests: AsyncIterator[StringValue], context: Any) -> AsyncIterator[StringValue]:
        async for request in requests:
            if request.value in KINDS:
                raise KINDS[request.value]("amid the stream", "")
            yield request


def _spin(seconds: float) -> None:
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        sum(range(1000))


def _grind() -> None:
    while True:
        check_cancelled()


@asynccontextmanager
async def running(server: grpc.aio.Server, context: ServiceContext) -> AsyncIterator[tuple[str, ...]]:
    probe = Probe(context)
    kinds: dict[str, tuple[Any, Any, type[Message]]] = {
        "Unary": (grpc.unary_unary_rpc_method_handler, probe.unary, StringValue),
        "Size": (grpc.unary_unary_rpc_method_handler, probe.size, BytesValue),
        "Bytes": (grpc.unary_unary_rpc_method_handler, probe.bytes, StringValue),
        "Gathered": (grpc.stream_unary_rpc_method_handler, probe.gathered, StringValue),
        "Counted": (grpc.unary_stream_rpc_method_handler, probe.counted, StringValue),
        "UntilDraining": (grpc.unary_stream_rpc_method_handler, probe.until_draining, StringValue),
        "Echoed": (grpc.stream_stream_rpc_method_handler, probe.echoed, StringValue),
    }
    handlers = {
        name: make(behaviour, request.FromString, lambda answer: answer.SerializeToString())
        for name, (make, behaviour, request) in kinds.items()
    }
    server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler(SERVICE, handlers),))
    try:
        yield (SERVICE,)
    finally:
        probe.release.set()
        context.log.info("closed")


class Stub:
    """The client's side, over an asynchronous or a synchronous channel."""

    def __init__(self, channel: Any) -> None:
        def call(kind: Any, method: str, answer: Any = StringValue) -> Any:
            return kind(f"/{SERVICE}/{method}", lambda request: request.SerializeToString(), answer.FromString)

        self.unary = call(channel.unary_unary, "Unary")
        self.size = call(channel.unary_unary, "Size")
        self.bytes = call(channel.unary_unary, "Bytes", BytesValue)
        self.gathered = call(channel.stream_unary, "Gathered")
        self.counted = call(channel.unary_stream, "Counted")
        self.until_draining = call(channel.unary_stream, "UntilDraining")
        self.echoed = call(channel.stream_stream, "Echoed")


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("grace", type=float)
    parser.add_argument("--port", type=int, default=0)
    parser.add_argument("--health-socket", type=Path)
    parser.add_argument("--until-stdin-closes", action="store_true")
    given = parser.parse_args()
    settings = Settings(grace=given.grace, port=given.port, health_socket=given.health_socket)
    asyncio.run(serve("probe", running, settings, until_stdin_closes=given.until_stdin_closes))
