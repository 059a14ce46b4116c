"""gRPC channels to the services: message limits, bearer token and TLS in one place, asynchronous and synchronous."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import grpc
import grpc.aio

from pretouch.errors import InvalidInput
from pretouch.tls import channel_credentials

MESSAGE_LIMIT = 32 * 1024 * 1024
"""Bytes of a message, in either direction."""
SESSION_ID_METADATA = "pretouch-session-id"
SCAN_ID_METADATA = "pretouch-scan-id"
"""Call metadata that a service binds to its log lines."""

MESSAGE_LIMITS = (
    ("grpc.max_send_message_length", MESSAGE_LIMIT),
    ("grpc.max_receive_message_length", MESSAGE_LIMIT),
)
_TOKEN = re.compile(r"[!-~]+")
_OPTIONS = (
    *MESSAGE_LIMITS,
    ("grpc.enable_http_proxy", 0),  # the services are on this machine or its network, whatever the environment says
    ("grpc.lb_policy_name", "round_robin"),  # several copies behind one DNS name share the calls
    ("grpc.initial_reconnect_backoff_ms", 200),
    ("grpc.max_reconnect_backoff_ms", 3000),  # gRPC's own two minutes would outlast a restarted service
)


def open_channel(
    address: str,
    token: str | None = None,
    tls_ca: Path | None = None,
    tls_cert: Path | None = None,
    tls_key: Path | None = None,
    *,
    server_name: str | None = None,
) -> grpc.aio.Channel:
    """A channel to `host:port` (or a gRPC target such as `dns:///host:port`) for asyncio.

    Open it in the event loop that it is used in; it connects on first use. With `tls_ca` it speaks TLS and trusts that
    authority alone; `tls_cert` and `tls_key` are shown to a server that asks for a client's certificate. The token
    travels with every call, over plain TCP too.

    Args:
        server_name: what the server's certificate names, if not the host.

    Raises:
        InvalidInput: the address is none, the token or a TLS file cannot be used, or no event loop runs.
    """
    _check(address, token, tls_ca, tls_cert, tls_key)
    _check_loop()
    interceptors = [kind(token) for kind in _AIO_INTERCEPTORS] if token else None
    if tls_ca is None:
        return grpc.aio.insecure_channel(address, _OPTIONS, interceptors=interceptors)
    credentials = channel_credentials(tls_ca, tls_cert, tls_key)
    name = (("grpc.ssl_target_name_override", server_name),) if server_name else ()
    return grpc.aio.secure_channel(address, credentials, (*_OPTIONS, *name), interceptors=interceptors)


def open_sync_channel(
    address: str,
    token: str | None = None,
    tls_ca: Path | None = None,
    tls_cert: Path | None = None,
    tls_key: Path | None = None,
) -> grpc.Channel:
    """As `open_channel`, for programs without asyncio."""
    _check(address, token, tls_ca, tls_cert, tls_key)
    if tls_ca is None:
        channel = grpc.insecure_channel(address, _OPTIONS)
    else:
        channel = grpc.secure_channel(address, channel_credentials(tls_ca, tls_cert, tls_key), _OPTIONS)
    return grpc.intercept_channel(channel, _SyncToken(token)) if token else channel


def check_token(token: str) -> str:
    """Raises `InvalidInput` unless the token can be sent in a header."""
    if not isinstance(token, str) or _TOKEN.fullmatch(token) is None:
        raise InvalidInput(
            "The token has characters that no header can carry.", "Use printable ASCII characters without spaces."
        )
    return token


def _check(address: str, token: str | None, tls_ca: Path | None, tls_cert: Path | None, tls_key: Path | None) -> None:
    port = re.fullmatch(r"[!-~]+:([0-9]{1,5})", address) if isinstance(address, str) else None
    if port is None or "://" in address.replace(":///", "") or not 0 < int(port.group(1)) < 65536:
        raise InvalidInput(f"{address!r:.200} is not a gRPC address.", "Give host:port, such as 127.0.0.1:50050.")
    if token:
        check_token(token)
    if tls_ca is None and (tls_cert is not None or tls_key is not None):
        raise InvalidInput(
            "There is a client certificate, but no authority to trust.", "Give the server's certificate authority too."
        )


def _check_loop() -> None:
    try:
        asyncio.get_running_loop()
    except RuntimeError as error:
        raise InvalidInput(
            "No event loop runs.", "Connect in a coroutine, such as the one that asyncio.run starts."
        ) from error


class _Details(NamedTuple):
    """The fields of `grpc.ClientCallDetails`."""

    method: Any
    timeout: Any
    metadata: Any
    credentials: Any
    wait_for_ready: Any
    compression: Any


class _AioToken:
    """Adds the token to a call; gRPC wants one class for each kind of call."""

    def __init__(self, token: str) -> None:
        self._value = f"Bearer {token}"

    async def _call(self, continuation: Callable[..., Any], details: Any, request: Any) -> Any:
        metadata = grpc.aio.Metadata(*(details.metadata or ()))
        metadata.add("authorization", self._value)
        return await continuation(details._replace(metadata=metadata), request)


class _UnaryUnaryToken(_AioToken, grpc.aio.UnaryUnaryClientInterceptor):  # type: ignore[misc]
    intercept_unary_unary = _AioToken._call


class _UnaryStreamToken(_AioToken, grpc.aio.UnaryStreamClientInterceptor):  # type: ignore[misc]
    intercept_unary_stream = _AioToken._call


class _StreamUnaryToken(_AioToken, grpc.aio.StreamUnaryClientInterceptor):  # type: ignore[misc]
    intercept_stream_unary = _AioToken._call


class _StreamStreamToken(_AioToken, grpc.aio.StreamStreamClientInterceptor):  # type: ignore[misc]
    intercept_stream_stream = _AioToken._call


_AIO_INTERCEPTORS = (_UnaryUnaryToken, _UnaryStreamToken, _StreamUnaryToken, _StreamStreamToken)


class _SyncToken(
    grpc.UnaryUnaryClientInterceptor,  # type: ignore[misc]
    grpc.UnaryStreamClientInterceptor,  # type: ignore[misc]
    grpc.StreamUnaryClientInterceptor,  # type: ignore[misc]
    grpc.StreamStreamClientInterceptor,  # type: ignore[misc]
):
    """Adds the token to every kind of call."""

    def __init__(self, token: str) -> None:
        self._header = ("authorization", f"Bearer {token}")

    def _call(self, continuation: Callable[..., Any], details: Any, request: Any) -> Any:
        metadata = (*(details.metadata or ()), self._header)
        return continuation(
            _Details(
                details.method,
                details.timeout,
                metadata,
                details.credentials,
                details.wait_for_ready,
                details.compression,
            ),
            request,
        )

    intercept_unary_unary = _call
    intercept_unary_stream = _call
    intercept_stream_unary = _call
    intercept_stream_stream = _call
