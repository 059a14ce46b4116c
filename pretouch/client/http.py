"""httpx clients for the orchestrator: address, token, TLS and connections in one place, asynchronous and synchronous.

Proxy settings of the environment are ignored: robots are on a local network.
"""

from __future__ import annotations

import re
import ssl
from collections.abc import Iterator
from contextlib import contextmanager
from urllib.parse import urlsplit

import httpcore
import httpx

from pretouch.channel import check_token
from pretouch.client.arguments import FilePath, as_path
from pretouch.client.bounded_transport import BoundedTransport
from pretouch.errors import DeadlineExceeded, Internal, InvalidInput, unreachable
from pretouch.tls import client_context

REST_ADDRESS = "http://127.0.0.1:8080"
_UNLIMITED = httpx.Limits(max_connections=None, max_keepalive_connections=None)
"""An event stream holds its connection, and must not keep a call waiting for another one."""


def open_async_http(
    base_url: str, token: str | None, tls_ca: FilePath | None, tls_cert: FilePath | None, tls_key: FilePath | None
) -> httpx.AsyncClient:
    """A client for asyncio.

    Raises:
        InvalidInput: address, token or TLS files cannot be used.
    """
    headers, context = _check(base_url, token, tls_ca, tls_cert, tls_key)
    return httpx.AsyncClient(base_url=base_url, headers=headers, verify=context, limits=_UNLIMITED, trust_env=False)


def open_http(
    base_url: str, token: str | None, tls_ca: FilePath | None, tls_cert: FilePath | None, tls_key: FilePath | None
) -> httpx.Client:
    """As `open_async_http`, for programs without asyncio; its requests keep to `time_limit.within`."""
    headers, context = _check(base_url, token, tls_ca, tls_cert, tls_key)
    return httpx.Client(base_url=base_url, headers=headers, transport=BoundedTransport(context), trust_env=False)


@contextmanager
def raising_transport_errors(base_url: str) -> Iterator[None]:
    """Failed connections become the errors of pretouch that they stand for."""
    try:
        yield
    except (httpx.TimeoutException, httpcore.TimeoutException) as error:
        raise DeadlineExceeded(
            f"{base_url} did not answer in time.",
            "Try again, or allow a longer timeout; check that the orchestrator runs at this address.",
        ) from error
    except (httpx.TransportError, httpcore.NetworkError, httpcore.ProtocolError) as error:
        raise unreachable(f"{base_url} cannot be reached: {str(error) or type(error).__name__:.300}.") from error
    except (httpx.HTTPError, httpx.StreamError) as error:
        raise Internal(
            f"The answer of {base_url} cannot be read: {error}.",
            "Check that the address is that of a pretouch orchestrator, and any proxy in between.",
        ) from error


def _check(
    base_url: str, token: str | None, ca: FilePath | None, cert: FilePath | None, key: FilePath | None
) -> tuple[dict[str, str], ssl.SSLContext]:
    """The headers of every request, and whom to trust."""
    try:
        if re.search(r"[\s\x00-\x1f\x7f]", base_url):
            raise ValueError("it has spaces or other characters that an address has not")
        parts, parsed = urlsplit(base_url), httpx.URL(base_url)
        if parts.scheme not in ("http", "https") or not parsed.host or parts.port == 0 or parts.query or parts.fragment:
            raise ValueError("http:// or https://, a host and, if need be, a port and a path make one")
    except (TypeError, ValueError, httpx.InvalidURL) as error:
        raise InvalidInput(
            f"{base_url!r:.200} is not an HTTP address: {error}.", f"Give a URL such as {REST_ADDRESS}."
        ) from error
    headers = {"Authorization": f"Bearer {check_token(token)}"} if token else {}
    if parts.scheme == "https":
        return headers, client_context(as_path(ca), as_path(cert), as_path(key))
    if ca is not None or cert is not None or key is not None:
        raise InvalidInput(
            f"There are TLS files, but {base_url} is not encrypted.", "Give an https:// address, or no TLS files."
        )
    return headers, ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
