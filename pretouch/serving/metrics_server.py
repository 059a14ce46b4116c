"""The metrics of a service on a port of their own, from threads of their own: they answer while the service is busy."""

from __future__ import annotations

import socket
import ssl
import threading
from collections.abc import Callable, Iterable
from contextlib import suppress
from socketserver import ThreadingMixIn
from typing import Any
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer

from prometheus_client import CollectorRegistry, make_wsgi_app

from pretouch.errors import wire_of
from pretouch.serving.admission import TokenCheck
from pretouch.serving.settings import Settings
from pretouch.tls import server_context

_MAX_CONNECTIONS = 16
_PATIENCE = 10.0  # s for a whole request and its answer

_App = Callable[[dict[str, Any], Callable[..., Any]], Iterable[bytes]]


class MetricsServer:
    """Serves `registry` on the settings' host and metrics port, over their TLS, to those who carry a token.

    Raises:
        OSError: the port cannot be bound.
    """

    def __init__(self, registry: CollectorRegistry, settings: Settings, token_check: TokenCheck) -> None:
        app = make_wsgi_app(registry)
        context = None
        if settings.tls_cert is not None and settings.tls_key is not None:
            context = server_context(settings.tls_cert, settings.tls_key, settings.tls_client_ca)
        self._server = _Server(settings.host, settings.metrics_port or 0, context)
        self._server.set_app(app if settings.open_metrics else _guard(app, token_check))
        self._thread = threading.Thread(target=self._server.serve_forever, name="pretouch-metrics", daemon=True)
        self._thread.start()
        self.port: int = self._server.server_port

    def close(self) -> None:
        """Ends the thread; takes up to half a second."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


def _guard(app: _App, token_check: TokenCheck) -> _App:
    def guarded(environ: dict[str, Any], start_response: Callable[..., Any]) -> Iterable[bytes]:
        authorization = environ.get("HTTP_AUTHORIZATION", "").encode("latin-1")
        if token_check.identify(authorization) is not None:
            return app(environ, start_response)
        error = token_check.refuse(authorization, environ.get("REMOTE_ADDR", ""))
        headers = [("Content-Type", "text/plain; charset=utf-8"), ("WWW-Authenticate", "Bearer")]
        start_response(f"{wire_of(error).http_status} {wire_of(error).title}", headers)
        return [f"{error.detail} {error.remedy}\n".encode()]

    return guarded


class _Handler(WSGIRequestHandler):
    def log_message(self, format: str, *args: Any) -> None:
        """Nothing: it is polled every few seconds."""


class _Server(ThreadingMixIn, WSGIServer):
    """A thread for each of a few connections, which end after a while whatever their clients do."""

    daemon_threads = True

    def __init__(self, host: str, port: int, context: ssl.SSLContext | None) -> None:
        self.address_family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self._context = context
        self._free = threading.BoundedSemaphore(_MAX_CONNECTIONS)
        super().__init__((host, port), _Handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        if self._free.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        end = threading.Timer(_PATIENCE, _cut, (request,))
        end.daemon = True
        end.start()
        try:
            super().process_request_thread(request, client_address)
        finally:
            end.cancel()
            self._free.release()

    def finish_request(self, request: Any, client_address: Any) -> None:
        if self._context is None:
            super().finish_request(request, client_address)
            return
        request.settimeout(_PATIENCE)
        with self._context.wrap_socket(request.dup(), server_side=True) as secure:
            super().finish_request(secure, client_address)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Nothing: the client has gone, was too slow, or speaks no TLS."""


def _cut(connection: socket.socket) -> None:
    with suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)
