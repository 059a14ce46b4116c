"""A service's gRPC server from its start to its last answer."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Sequence
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from typing import Any, cast

import grpc
import grpc.aio
from grpc_health.v1 import health, health_pb2, health_pb2_grpc
from grpc_reflection.v1alpha import reflection, reflection_pb2_grpc

from pretouch.channel import MESSAGE_LIMITS
from pretouch.errors import PretouchError, Unavailable
from pretouch.serving.admission import AdmissionControl
from pretouch.serving.context import ServiceContext
from pretouch.serving.exposure import warn_if_exposed
from pretouch.serving.interceptor import CallInterceptor
from pretouch.serving.metrics_server import MetricsServer
from pretouch.serving.open_files import get_connection_limit
from pretouch.serving.settings import Settings
from pretouch.tls import server_credentials

Running = Callable[[grpc.aio.Server, ServiceContext], AbstractAsyncContextManager[tuple[str, ...]]]
"""A service: registers its servicers, warms up, yields their full names, and closes what it opened."""

_METADATA_LIMIT = 16 * 1024  # bytes of a call's metadata
_OPTIONS = (
    *MESSAGE_LIMITS,
    ("grpc.so_reuseport", 0),  # a second server on the same port fails instead of taking half of the calls
    ("grpc.keepalive_time_ms", 60_000),  # finds out that the other end of a quiet stream is gone
    ("grpc.keepalive_timeout_ms", 20_000),
    ("grpc.http2.min_ping_interval_without_data_ms", 1_000),  # clients may do so too, as often as they like
    ("grpc.keepalive_permit_without_calls", 1),
    ("grpc.server_handshake_timeout_ms", 10_000),
    ("grpc.max_connection_idle_ms", 600_000),  # without a call; no limit to the age of those with a stream
    ("grpc.max_concurrent_streams", 1_000),
    ("grpc.max_metadata_size", _METADATA_LIMIT),
    ("grpc.absolute_max_metadata_size", _METADATA_LIMIT),
)
_READINESS_PERIOD = 2.0
"""s between two looks at whether a service is ready."""
_SERVING = health_pb2.HealthCheckResponse.SERVING
_NOT_SERVING = health_pb2.HealthCheckResponse.NOT_SERVING


@dataclass(frozen=True)
class Started:
    """A service that serves."""

    context: ServiceContext
    port: int
    """The bound gRPC port."""
    metrics_port: int | None
    """The bound port of the metrics, None where they are off."""


class _Registry(grpc.GenericRpcHandler):  # type: ignore[misc]
    """Takes servicers while the server already runs, so that health is answered during the warm-up."""

    def __init__(self) -> None:
        self._handlers: list[Any] = []

    def add_generic_rpc_handlers(self, handlers: Iterable[Any]) -> None:
        self._handlers.extend(handlers)

    def add_registered_method_handlers(self, service: str, handlers: dict[str, Any]) -> None:
        """Generated code gives the same methods as generic handlers too."""

    def service(self, details: grpc.HandlerCallDetails) -> Any:
        return next((found for handler in self._handlers if (found := handler.service(details)) is not None), None)


@asynccontextmanager
async def started(name: str, running: Running, settings: Settings) -> AsyncIterator[Started]:
    """Serves `running` for as long as the block lasts, then drains: running calls get `settings.grace` to finish.

    The health service says SERVING between warm-up and drain, for the server ("") and each service by name; by name
    only while the service is ready, if it says whether it is. So a server that waits for another is not restarted.

    Raises:
        InvalidInput: TLS material that cannot be used.
        Unavailable: a port cannot be bound.
    """
    async with AsyncExitStack() as stack:
        context = ServiceContext(name, settings)
        stack.callback(context.close)
        admission = AdmissionControl()
        registry = _Registry()
        interceptors = (CallInterceptor(context, admission),)
        options = (*_OPTIONS, ("grpc.max_allowed_incoming_connections", get_connection_limit()))
        server = grpc.aio.server(handlers=(registry,), interceptors=interceptors, options=options)
        statuses = health.aio.HealthServicer()
        await statuses.set("", _NOT_SERVING)
        health_pb2_grpc.add_HealthServicer_to_server(statuses, server)
        port = _bind(server, settings)
        metrics_port = _serve_metrics(stack, context, settings)
        warn_if_exposed(context, "gRPC", settings.host)
        stack.push_async_callback(server.stop, None)
        await server.start()
        services = await stack.enter_async_context(running(cast(grpc.aio.Server, registry), context))
        context.share_memory()
        names = (*services, health.SERVICE_NAME, reflection.SERVICE_NAME)
        reflection_pb2_grpc.add_ServerReflectionServicer_to_server(reflection.aio.ReflectionServicer(names), registry)
        admission.open()
        for service in ("", *services):
            await statuses.set(service, _SERVING)
        if context.readiness is not None:
            telling = asyncio.create_task(_tell_readiness(context.readiness, statuses, services))
            stack.callback(telling.cancel)
        try:
            yield Started(context, port, metrics_port)
        finally:
            await statuses.enter_graceful_shutdown()
            context.draining.set()
            await admission.drain(settings.grace)
            await server.stop(None)


async def _tell_readiness(check: Callable[[], Awaitable[None]], statuses: Any, services: Sequence[str]) -> None:
    while True:
        status = _SERVING
        try:
            await check()
        except PretouchError:
            status = _NOT_SERVING
        for service in services:
            await statuses.set(service, status)
        await asyncio.sleep(_READINESS_PERIOD)


def _bind(server: grpc.aio.Server, settings: Settings) -> int:
    address = settings.address(settings.port)
    credentials = None
    if settings.tls_cert is not None and settings.tls_key is not None:
        credentials = server_credentials(settings.tls_cert, settings.tls_key, settings.tls_client_ca)
    if settings.health_socket is not None:
        server.add_insecure_port(f"unix:{settings.health_socket}")
    try:
        if credentials is None:
            return int(server.add_insecure_port(address))
        return int(server.add_secure_port(address, credentials))
    except RuntimeError as error:
        raise _cannot_listen(address) from error


def _serve_metrics(stack: AsyncExitStack, context: ServiceContext, settings: Settings) -> int | None:
    if settings.metrics_port is None:
        return None
    try:
        server = MetricsServer(context.metrics.registry, settings, context.token_check)
    except OSError as error:
        raise _cannot_listen(settings.address(settings.metrics_port)) from error
    stack.push_async_callback(context.run_briefly, server.close)
    return server.port


def _cannot_listen(address: str) -> Unavailable:
    return Unavailable(
        f"The service cannot listen on {address}.",
        "Choose a free port (--port; of pretouch up --rest-port, --grpc-port or --gateway-port) and an address of this "
        "machine; another service may already run there.",
    )
