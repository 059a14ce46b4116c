"""HTTP over sockets that keep to the limit of the whole call.

httpx, as most HTTP libraries, limits each operation: a server that sends a byte now and then is listened to for ever,
and a name that is not resolved is waited for.
"""

from __future__ import annotations

import socket
import ssl
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import httpcore
import httpx

from pretouch.client.time_limit import shorten


class BoundedTransport(httpx.BaseTransport):
    """Sends requests over as many connections as are needed at once; they keep to `time_limit.within`."""

    def __init__(self, context: ssl.SSLContext) -> None:
        self._pool = httpcore.ConnectionPool(
            ssl_context=context, max_connections=None, keepalive_expiry=5.0, network_backend=_BoundedBackend()
        )

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        url = request.url
        response = self._pool.handle_request(
            httpcore.Request(
                request.method,
                httpcore.URL(scheme=url.raw_scheme, host=url.raw_host, port=url.port, target=url.raw_path),
                headers=request.headers.raw,
                content=request.stream,
                extensions=request.extensions,
            )
        )
        return httpx.Response(
            response.status,
            headers=response.headers,
            stream=_ResponseStream(response),
            extensions=response.extensions,
        )

    def close(self) -> None:
        self._pool.close()


class _ResponseStream(httpx.SyncByteStream):
    def __init__(self, response: httpcore.Response) -> None:
        self._response = response

    def __iter__(self) -> Iterator[bytes]:
        return self._response.iter_stream()

    def close(self) -> None:
        self._response.close()


class _BoundedBackend(httpcore.NetworkBackend):
    def __init__(self) -> None:
        self._unbounded = httpcore.SyncBackend()

    def connect_tcp(
        self,
        host: str,
        port: int,
        timeout: float | None = None,
        local_address: str | None = None,
        socket_options: Iterable[httpcore.SOCKET_OPTION] | None = None,
    ) -> httpcore.NetworkStream:
        with _raising(httpcore.ConnectTimeout, httpcore.ConnectError):
            addresses = _resolve(host, port, shorten(timeout))
        for others in reversed(range(len(addresses))):
            address = addresses[-1 - others]
            try:
                with _raising(httpcore.ConnectTimeout, httpcore.ConnectError):
                    seconds = shorten(timeout) / (1 + others)
                stream = self._unbounded.connect_tcp(address, port, seconds, local_address, socket_options)
                return _BoundedStream(stream)
            except (httpcore.ConnectTimeout, httpcore.ConnectError):
                if not others:
                    raise
        raise httpcore.ConnectError(f"The name {host} has no address.")


class _BoundedStream(httpcore.NetworkStream):
    def __init__(self, unbounded: httpcore.NetworkStream) -> None:
        self._unbounded = unbounded

    def read(self, max_bytes: int, timeout: float | None = None) -> bytes:
        with _raising(httpcore.ReadTimeout, httpcore.ReadError):
            return self._unbounded.read(max_bytes, shorten(timeout))

    def write(self, buffer: bytes, timeout: float | None = None) -> None:
        connection: socket.socket = self._unbounded.get_extra_info("socket")
        left = memoryview(buffer)
        with _raising(httpcore.WriteTimeout, httpcore.WriteError):
            while left:
                connection.settimeout(shorten(timeout))
                left = left[connection.send(left) :]

    def close(self) -> None:
        with suppress(OSError):  # another thread may be reading, which closing alone would not end
            self._unbounded.get_extra_info("socket").shutdown(socket.SHUT_RDWR)
        self._unbounded.close()

    def start_tls(
        self, ssl_context: ssl.SSLContext, server_hostname: str | None = None, timeout: float | None = None
    ) -> httpcore.NetworkStream:
        with _raising(httpcore.ConnectTimeout, httpcore.ConnectError):
            return _BoundedStream(self._unbounded.start_tls(ssl_context, server_hostname, shorten(timeout)))

    def get_extra_info(self, info: str) -> Any:
        return self._unbounded.get_extra_info(info)


@contextmanager
def _raising(late: type[Exception], failed: type[Exception]) -> Iterator[None]:
    """Errors of sockets in httpcore's words."""
    try:
        yield
    except TimeoutError as error:
        raise late(str(error)) from error
    except (OSError, UnicodeError) as error:
        raise failed(str(error)) from error


def _resolve(host: str, port: int, seconds: float) -> list[str]:
    """The addresses of `host`, found in a thread that is left alone when it takes too long: nothing interrupts it."""
    addresses: list[str] = []
    failures: list[Exception] = []

    def resolve() -> None:
        try:
            found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
            addresses.extend(str(address[0]) for *_, address in found)
        except Exception as error:
            failures.append(error)

    thread = threading.Thread(target=resolve, name="resolve", daemon=True)
    thread.start()
    thread.join(min(seconds, threading.TIMEOUT_MAX))
    if thread.is_alive():
        raise TimeoutError(f"The name {host} was not resolved in time.")
    if failures:
        raise failures[0]
    return addresses
