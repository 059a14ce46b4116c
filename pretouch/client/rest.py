"""The REST clients, synchronous and asynchronous."""

from __future__ import annotations

import ssl
from collections.abc import AsyncGenerator, Iterator
from os import PathLike
from typing import Any
from urllib.parse import urlsplit

import httpx

from pretouch.client.asynchronous import AsyncClient
from pretouch.client.events import QUIET, Event, ServerSentEvents
from pretouch.client.rest_api import (
    HttpMessage,
    RestSessionApi,
    convert_transport_error,
    raise_for_problem,
    session_path,
)
from pretouch.client.retries import TIMEOUT
from pretouch.client.synchronous import SyncClient
from pretouch.errors import InvalidInput

REST_ADDRESS = "http://127.0.0.1:8080"


def _make_options(
    base_url: str,
    token: str | None,
    tls_ca: str | PathLike[str] | None,
    tls_cert: str | PathLike[str] | None,
    tls_key: str | PathLike[str] | None,
) -> dict[str, Any]:
    """Arguments of both httpx clients. Proxy settings of the environment are ignored: robots are on a local network."""
    if urlsplit(base_url).scheme not in ("http", "https"):
        raise InvalidInput(f"{base_url!r} is not an HTTP address.", f"Give a URL such as {REST_ADDRESS}.")
    options: dict[str, Any] = {"base_url": base_url, "trust_env": False}
    if token is not None:
        options["headers"] = {"Authorization": f"Bearer {token}"}
    if tls_ca is not None or tls_cert is not None:
        try:
            options["verify"] = context = ssl.create_default_context(cafile=tls_ca)
            if tls_cert is not None:
                context.load_cert_chain(tls_cert, tls_key)
        except OSError as error:  # an SSLError is one too
            raise InvalidInput(f"The TLS files cannot be used: {error}.", "Give readable PEM files.") from error
    return options


def _build_event_request(session_id: str, after: int, timeout: float) -> dict[str, Any]:
    headers = {"Accept": "text/event-stream"} | ({"Last-Event-ID": str(after)} if after else {})
    url = session_path(session_id) + "/events"
    return {"method": "GET", "url": url, "headers": headers, "timeout": httpx.Timeout(timeout, read=QUIET)}


class RestClient(SyncClient[HttpMessage, httpx.Response]):
    """A synchronous client of the orchestrator over REST.

    Args:
        base_url: `http://host:port`, or `https://host:port` if the orchestrator serves TLS.
        token: the orchestrator's bearer token, if it requires one.
        tls_ca: PEM file of the certificate authority to trust; left out: those of the system.
        tls_cert, tls_key: PEM files of this client's certificate, if the orchestrator requires one.
        timeout: s for a whole call, retries included.
    """

    def __init__(
        self,
        base_url: str = REST_ADDRESS,
        *,
        token: str | None = None,
        tls_ca: str | PathLike[str] | None = None,
        tls_cert: str | PathLike[str] | None = None,
        tls_key: str | PathLike[str] | None = None,
        timeout: float = TIMEOUT,
    ) -> None:
        super().__init__(RestSessionApi(), timeout)
        self._base_url = base_url
        self._http = httpx.Client(**_make_options(base_url, token, tls_ca, tls_cert, tls_key))

    def close(self) -> None:
        self._http.close()

    def _send(self, message: HttpMessage, seconds: float) -> httpx.Response:
        try:
            return self._http.request(message.method, message.path, timeout=seconds, **message.options)
        except httpx.TransportError as error:
            raise convert_transport_error(error, self._base_url) from error

    def _listen(self, session_id: str, after: int) -> Iterator[Event]:
        parser = ServerSentEvents()
        try:
            with self._http.stream(**_build_event_request(session_id, after, self._timeout)) as response:
                if response.is_error:
                    response.read()
                    raise_for_problem(response)
                for chunk in response.iter_bytes():
                    yield from parser.feed(chunk)
        except httpx.TransportError as error:
            raise convert_transport_error(error, self._base_url) from error


class AsyncRestClient(AsyncClient[HttpMessage, httpx.Response]):
    """An asynchronous client of the orchestrator over REST; arguments as for `RestClient`."""

    def __init__(
        self,
        base_url: str = REST_ADDRESS,
        *,
        token: str | None = None,
        tls_ca: str | PathLike[str] | None = None,
        tls_cert: str | PathLike[str] | None = None,
        tls_key: str | PathLike[str] | None = None,
        timeout: float = TIMEOUT,
    ) -> None:
        super().__init__(RestSessionApi(), timeout)
        self._base_url = base_url
        self._http = httpx.AsyncClient(**_make_options(base_url, token, tls_ca, tls_cert, tls_key))

    async def close(self) -> None:
        await self._http.aclose()

    async def _send(self, message: HttpMessage, seconds: float) -> httpx.Response:
        try:
            return await self._http.request(message.method, message.path, timeout=seconds, **message.options)
        except httpx.TransportError as error:
            raise convert_transport_error(error, self._base_url) from error

    async def _listen(self, session_id: str, after: int) -> AsyncGenerator[Event]:
        parser = ServerSentEvents()
        try:
            async with self._http.stream(**_build_event_request(session_id, after, self._timeout)) as response:
                if response.is_error:
                    await response.aread()
                    raise_for_problem(response)
                async for chunk in response.aiter_bytes():
                    for event in parser.feed(chunk):
                        yield event
        except httpx.TransportError as error:
            raise convert_transport_error(error, self._base_url) from error
