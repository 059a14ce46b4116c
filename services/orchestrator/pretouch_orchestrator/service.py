"""The orchestrator as a service: opens what it needs, serves gRPC and REST, and closes in reverse."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import AsyncExitStack, asynccontextmanager

import grpc.aio

from pretouch.channel import open_channel
from pretouch.errors import PretouchError, Unavailable
from pretouch.serving import ServiceContext
from pretouch.v1.orchestrator_pb2_grpc import add_OrchestratorServiceServicer_to_server
from pretouch_orchestrator.rest.app import rest_app
from pretouch_orchestrator.rest.server import rest_serving
from pretouch_orchestrator.servicer import SERVICE, OrchestratorServicer
from pretouch_orchestrator.sessions.loop import Loop
from pretouch_orchestrator.sessions.manager import Sessions
from pretouch_orchestrator.settings import OrchestratorSettings
from pretouch_orchestrator.store.sqlite import SqliteStore, open_store
from pretouch_orchestrator.upstream.clients import GrpcDetector, GrpcGateway, GrpcRegistrar, Scenes
from pretouch_orchestrator.upstream.connection import Upstream


@asynccontextmanager
async def running(server: grpc.aio.Server, context: ServiceContext) -> AsyncIterator[tuple[str, ...]]:
    """Serves gRPC on `server` and REST beside it, with the settings of the environment.

    Raises:
        InvalidInput: a setting is missing or wrong.
        Unavailable: the state directory or the REST port cannot be had.
    """
    settings = OrchestratorSettings.from_environment(os.environ)
    async with AsyncExitStack() as stack:
        store = await stack.enter_async_context(open_store(settings.state))

        async def upstream(name: str, address: str) -> Upstream:
            cert, key = (context.settings.tls_cert, context.settings.tls_key) if settings.tls_ca else (None, None)
            channel = open_channel(address, context.settings.token, settings.tls_ca, cert, key)
            return Upstream(name, address, await stack.enter_async_context(channel))

        detector = await upstream("detector", settings.detector)
        registrar = await upstream("registrar", settings.registrar)
        upstreams = [detector, registrar]
        gateway = None
        if settings.gateway is not None:
            upstreams.append(await upstream("sensor gateway", settings.gateway))
            gateway = GrpcGateway(upstreams[-1])
        scenes = Scenes()
        loop = Loop(GrpcDetector(detector, scenes), GrpcRegistrar(registrar, scenes))
        sessions = Sessions(store, loop, gateway, context)
        stack.push_async_callback(sessions.close)
        add_OrchestratorServiceServicer_to_server(OrchestratorServicer(sessions, context), server)
        app = rest_app(sessions, context, _check_of(store, upstreams))
        await stack.enter_async_context(rest_serving(app, settings, context))
        ending = asyncio.create_task(_end_streams_when_draining(sessions, context))
        stack.callback(ending.cancel)
        yield (SERVICE,)


def _check_of(store: SqliteStore, upstreams: Sequence[Upstream]) -> Callable[[], Awaitable[None]]:
    async def check() -> None:
        results = await asyncio.gather(
            store.check(), *(upstream.check() for upstream in upstreams), return_exceptions=True
        )
        failures = [result for result in results if isinstance(result, BaseException)]
        for failure in failures:
            if not isinstance(failure, PretouchError):
                raise failure
        if failures:
            raise Unavailable(
                " ".join(str(failure) for failure in failures), "Start or mend what is named, then look again."
            )

    return check


async def _end_streams_when_draining(sessions: Sessions, context: ServiceContext) -> None:
    await context.draining.wait()
    sessions.end_streams()
