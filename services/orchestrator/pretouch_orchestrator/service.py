"""The orchestrator as a service: opens its resources, serves gRPC and REST, and closes in reverse order."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

import grpc.aio

from pretouch.channel import open_channel
from pretouch.serving import ServiceContext
from pretouch.v1 import detector_pb2_grpc, registrar_pb2_grpc
from pretouch.v1 import sensor_gateway_pb2_grpc as gateway_pb2_grpc
from pretouch.v1.orchestrator_pb2_grpc import add_OrchestratorServiceServicer_to_server
from pretouch_orchestrator.readiness import Readiness
from pretouch_orchestrator.rest.app import create_rest_app
from pretouch_orchestrator.rest.hosts import HostCheck
from pretouch_orchestrator.rest.server import serve_rest
from pretouch_orchestrator.servicer import SERVICE, OrchestratorServicer
from pretouch_orchestrator.sessions.loop import Loop
from pretouch_orchestrator.sessions.manager import SessionManager
from pretouch_orchestrator.sessions.upkeep import Limits, Upkeep
from pretouch_orchestrator.settings import OrchestratorSettings
from pretouch_orchestrator.store import open_store
from pretouch_orchestrator.upstream.addresses import Addresses
from pretouch_orchestrator.upstream.clients import DetectorClient, GatewayClient, RegistrarClient
from pretouch_orchestrator.upstream.connection import UpstreamConnection
from pretouch_orchestrator.upstream.copies import Copies
from pretouch_orchestrator.upstream.devices import Devices


@asynccontextmanager
async def running(server: grpc.aio.Server, context: ServiceContext) -> AsyncIterator[tuple[str, ...]]:
    """Serves gRPC on `server` and REST beside it, with the settings of the environment.

    Raises:
        InvalidInput: a setting is missing or wrong.
        Unavailable: the session store or the REST port is not usable.
    """
    settings = OrchestratorSettings.from_environment(os.environ)
    async with AsyncExitStack() as stack:
        store = await stack.enter_async_context(open_store(settings.store))

        async def connect(name: str, addresses: Addresses, make_stub: Callable[[grpc.aio.Channel], Any]) -> Copies:
            def open_connection(address: str) -> UpstreamConnection:
                cert, key = (context.settings.tls_cert, context.settings.tls_key) if settings.tls_ca else (None, None)
                token, server = context.settings.token, addresses.name or None
                channel = open_channel(address, token, settings.tls_ca, cert, key, server_name=server)
                return UpstreamConnection(name, address, channel, make_stub(channel))

            copies = Copies(name, addresses, open_connection)
            await stack.enter_async_context(copies.opened())
            return copies

        detector = await connect("detector", settings.detector, detector_pb2_grpc.DetectorServiceStub)
        registrar = await connect("registrar", settings.registrar, registrar_pb2_grpc.RegistrarServiceStub)
        upstreams = [detector, registrar]
        gateway = devices = None
        if settings.gateway is not None:
            address = Addresses((settings.gateway,))
            upstreams.append(await connect("sensor gateway", address, gateway_pb2_grpc.SensorGatewayServiceStub))
            gateway, devices = GatewayClient(upstreams[-1]), Devices(upstreams[-1])
        loop = Loop(DetectorClient(detector), RegistrarClient(registrar), gateway, context.go_on_in_thread)
        upkeep = Upkeep(store, Limits(settings.keep, settings.max_store), context.log)
        sessions = SessionManager(store, loop, context, upkeep)
        stack.push_async_callback(sessions.close)
        add_OrchestratorServiceServicer_to_server(OrchestratorServicer(sessions, context), server)
        hosts = HostCheck(settings.rest_host, settings.allowed_hosts)
        readiness = Readiness({"store": store.check} | {upstream.name: upstream.check for upstream in upstreams})
        context.readiness = readiness
        app = create_rest_app(sessions, context, readiness, hosts, devices)
        await stack.enter_async_context(serve_rest(app, settings, context))
        for work in (upkeep.run(), _end_streams_when_draining(sessions, context)):
            stack.push_async_callback(_stop, asyncio.create_task(work))
        yield (SERVICE,)


async def _stop(task: asyncio.Task[None]) -> None:
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


async def _end_streams_when_draining(sessions: SessionManager, context: ServiceContext) -> None:
    await context.draining.wait()
    sessions.end_streams()
