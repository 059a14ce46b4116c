"""The HTTP server of the REST contract. It shares the event loop with the gRPC server."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import ssl
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager

import uvicorn
from fastapi import FastAPI

from pretouch.errors import Unavailable
from pretouch.serving import ServiceContext
from pretouch_orchestrator.settings import OrchestratorSettings

_BACKLOG = 128


class _Server(uvicorn.Server):
    def __init__(self, config: uvicorn.Config) -> None:
        super().__init__(config)
        self.up = asyncio.Event()

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        self.up.set()

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Signals are handled by `pretouch.serving`."""
        yield


@asynccontextmanager
async def serve_rest(app: FastAPI, settings: OrchestratorSettings, context: ServiceContext) -> AsyncIterator[None]:
    """Serves `app` for as long as the block lasts; once the service drains, requests under way get its grace to end.

    Raises:
        Unavailable: the port cannot be bound.
    """
    tls = context.settings
    config = uvicorn.Config(
        app,
        http="h11",
        ws="none",
        lifespan="off",
        log_config=None,
        log_level="warning",
        access_log=False,
        server_header=False,
        timeout_graceful_shutdown=max(1, round(context.settings.grace)),
        ssl_certfile=tls.tls_cert,
        ssl_keyfile=tls.tls_key,
        ssl_ca_certs=None if tls.tls_client_ca is None else str(tls.tls_client_ca),
        ssl_cert_reqs=ssl.CERT_NONE if tls.tls_client_ca is None else ssl.CERT_REQUIRED,
    )
    with _bind(settings.rest_host, settings.rest_port) as listener:
        server = _Server(config)
        serving = asyncio.create_task(server.serve(sockets=[listener]))
        stopping = asyncio.create_task(_stop_when_draining(server, context))
        up = asyncio.create_task(server.up.wait())
        try:
            await asyncio.wait((serving, up), return_when=asyncio.FIRST_COMPLETED)
            if serving.done():
                serving.result()
            context.log.info(
                "REST", host=settings.rest_host, port=listener.getsockname()[1], tls=tls.tls_cert is not None
            )
            yield
        finally:
            stopping.cancel()
            up.cancel()
            server.should_exit = True
            await serving


async def _stop_when_draining(server: uvicorn.Server, context: ServiceContext) -> None:
    await context.draining.wait()
    server.should_exit = True


@contextlib.contextmanager
def _bind(host: str, port: int) -> Iterator[socket.socket]:
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        listener = socket.socket(family, kind, protocol)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen(_BACKLOG)
    except OSError as error:
        raise Unavailable(
            f"REST cannot be served at {host}:{port}: {error}.",
            "Free the port or set PRETOUCH_ORCHESTRATOR_REST_HOST and PRETOUCH_ORCHESTRATOR_REST_PORT.",
        ) from error
    with listener:
        yield listener
