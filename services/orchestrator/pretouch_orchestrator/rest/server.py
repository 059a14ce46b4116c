"""The HTTP server of the REST contract. It shares the event loop with the gRPC server.

uvicorn accepts connections by asyncio's own loop, which has no limit but that of open files, and writes a trace for
each one beyond that. `_Server` accepts them itself, and makes room for the newest.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import ssl
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, suppress
from operator import itemgetter
from typing import Any

import uvicorn
from fastapi import FastAPI

from pretouch.errors import Unavailable
from pretouch.serving import ServiceContext
from pretouch.serving.exposure import warn_if_exposed
from pretouch.serving.open_files import get_connection_limit
from pretouch_orchestrator.rest.body_limit import MAX_HEAD
from pretouch_orchestrator.rest.connection import PATIENCE, BoundedConnection
from pretouch_orchestrator.settings import OrchestratorSettings

_BACKLOG = 128
_HANDSHAKE_WITHIN = 10.0  # s, for TLS
_RETRY_AFTER = 1.0  # s after which a connection that could not be accepted is tried again
_CHECK_EVERY = 10  # of uvicorn's ticks, a tenth of a second each


class _Server(uvicorn.Server):
    """Serves at most `limit` connections, and those by their rules (`BoundedConnection`)."""

    def __init__(self, config: uvicorn.Config, limit: int, context: ServiceContext) -> None:
        super().__init__(config)
        self.up = asyncio.Event()
        self._limit = limit
        self._log = context.log
        self._tasks: set[asyncio.Task[Any]] = set()
        self._handshakes: dict[asyncio.Task[None], float] = {}  # since when, in the loop's time
        context.metrics.gauge("http_connections", "Open connections to REST.").set_function(lambda: self._open)

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup([])
        for listener in sockets or ():
            listener.setblocking(False)
            self._start(self._accept(listener))
        self.up.set()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        for task in self._tasks:
            task.cancel()
        await super().shutdown(sockets)

    async def on_tick(self, counter: int) -> bool:
        if counter % _CHECK_EVERY == 0:
            now = asyncio.get_running_loop().time()
            for connection in list(self.server_state.connections):
                if isinstance(connection, BoundedConnection):
                    connection.check(now)
        return await super().on_tick(counter)

    @property
    def _open(self) -> int:
        return len(self.server_state.connections) + len(self._handshakes)

    def _start(self, coroutine: Any) -> asyncio.Task[Any]:
        task = asyncio.create_task(coroutine)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    async def _accept(self, listener: socket.socket) -> None:
        loop = asyncio.get_running_loop()
        while True:
            try:
                accepted, _ = await loop.sock_accept(listener)
            except OSError as error:  # too many open files, or the client has gone
                self._log.warning("a connection could not be accepted", reason=str(error))
                await asyncio.sleep(_RETRY_AFTER)
                continue
            if self._open >= self._limit and not self._make_room():
                self._log.warning("a connection was refused: all are busy", connections=self._open)
                accepted.close()
                continue
            task = self._start(self._connect(accepted))
            self._handshakes[task] = loop.time()
            task.add_done_callback(self._handshakes.pop)
            await asyncio.sleep(0)

    async def _connect(self, accepted: socket.socket) -> None:
        """Makes the accepted socket a connection of uvicorn's; over TLS once the client has proved to speak it."""
        tls = {} if self.config.ssl is None else {"ssl_handshake_timeout": _HANDSHAKE_WITHIN}
        with suppress(OSError):  # what is no TLS, or has gone
            try:
                await asyncio.get_running_loop().connect_accepted_socket(
                    self._make_connection, accepted, ssl=self.config.ssl, **tls
                )
            except BaseException:
                accepted.close()
                raise

    def _make_connection(self) -> BoundedConnection:
        return BoundedConnection(self.config, self.server_state, self.lifespan.state)

    def _make_room(self) -> bool:
        """Closes the connection that has asked for nothing for the longest time, if there is one."""
        waiting: list[tuple[float, Callable[[], object]]] = [
            (connection.idle_since, connection.reset)
            for connection in self.server_state.connections
            if isinstance(connection, BoundedConnection) and connection.idle
        ]
        waiting += [(since, task.cancel) for task, since in self._handshakes.items()]
        if not waiting:
            return False
        _, close = min(waiting, key=itemgetter(0))
        close()
        return True

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Signals are handled by `pretouch.serving`."""
        yield


@asynccontextmanager
async def serve_rest(
    app: FastAPI, settings: OrchestratorSettings, context: ServiceContext, limit: int | None = None
) -> AsyncIterator[None]:
    """Serves `app` for as long as the block lasts; once the service drains, requests under way get its grace to end.

    Args:
        limit: most connections at once; None: as many as open files allow.

    Raises:
        Unavailable: the port cannot be bound.
    """
    tls = context.settings
    config = uvicorn.Config(
        app,
        http="h11",
        h11_max_incomplete_event_size=MAX_HEAD,
        ws="none",
        lifespan="off",
        timeout_keep_alive=round(PATIENCE),
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
    warn_if_exposed(context, "REST", settings.rest_host)
    with _bind(settings.rest_host, settings.rest_port) as listener:
        server = _Server(config, limit or get_connection_limit(), context)
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
