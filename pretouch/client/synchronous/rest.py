# Generated from pretouch/client/asynchronous by `make client`: change that.
"""The REST client."""

# ruff: noqa: ASYNC109 -- a call's timeout covers its retries, which a timeout around the call could not tell apart

from __future__ import annotations

from collections.abc import Generator

import httpx

from pretouch.channel import MESSAGE_LIMIT
from pretouch.client.api import Call
from pretouch.client.arguments import FilePath
from pretouch.client.events import QUIET, Event, ServerSentEvents
from pretouch.client.http import REST_ADDRESS, open_http, raising_transport_errors
from pretouch.client.rest_api import (
    HttpAnswer,
    HttpMessage,
    RestSessionApi,
    raise_for_problem,
    recording_call,
    report_call,
    session_path,
    with_trace,
)
from pretouch.client.retries import TIMEOUT
from pretouch.client.synchronous.client import SyncClient
from pretouch.client.time_limit import within
from pretouch.errors import NotFound, TooLarge, Unavailable
from pretouch.tracing import propagated


class RestClient(SyncClient[HttpMessage, HttpAnswer]):
    """A client of the orchestrator over REST.

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
        tls_ca: FilePath | None = None,
        tls_cert: FilePath | None = None,
        tls_key: FilePath | None = None,
        timeout: float = TIMEOUT,
    ) -> None:
        super().__init__(RestSessionApi(), timeout)
        self._base_url = base_url
        self._http = open_http(base_url, token, tls_ca, tls_cert, tls_key)

    def close(self) -> None:
        super().close()
        self._http.close()

    def report(self, session_id: str, *, timeout: float | None = None) -> bytes:
        """Downloads the session's report: one self-contained page of HTML, running or ended.

        Raises:
            NotFound: there is no such session.
            Unavailable: the orchestrator is older than reports.
        """
        return self._download(report_call(session_id), session_id, "reports", timeout)

    def recording(self, session_id: str, *, timeout: float | None = None) -> bytes:
        """Downloads the session's recording: an MCAP file, running or ended.

        Raises:
            NotFound: there is no such session.
            Unavailable: the orchestrator is older than recordings.
        """
        return self._download(recording_call(session_id), session_id, "recordings", timeout)

    def _download(
        self, call: Call[HttpMessage, HttpAnswer, bytes], session_id: str, kind: str, timeout: float | None
    ) -> bytes:
        try:
            return self._run(lambda: call, timeout)
        except NotFound as error:
            self.session(session_id, timeout=timeout)  # raises if it is the session that is unknown
            raise Unavailable(
                f"The orchestrator at {self._base_url} makes no {kind}.",
                "It is older than this client: update it, or read the session itself.",
            ) from error

    def _send(self, message: HttpMessage, seconds: float) -> HttpAnswer:
        with raising_transport_errors(self._base_url):
            with (
                within(seconds),
                self._http.stream(message.method, message.path, timeout=seconds, **with_trace(message)) as response,
            ):
                return _read(response, message.limit)

    def _listen(self, session_id: str, after: int) -> Generator[Event]:
        headers = propagated() | {"Accept": "text/event-stream"} | ({"Last-Event-ID": str(after)} if after else {})
        timeout = httpx.Timeout(self._timeout, read=QUIET)
        parser = ServerSentEvents()
        with raising_transport_errors(self._base_url):
            request = self._http.build_request(
                "GET", session_path(session_id) + "/events", headers=headers, timeout=timeout
            )
            with within(self._timeout):
                response = self._http.send(request, stream=True)
            try:
                if not response.is_success:
                    with within(self._timeout):
                        raise_for_problem(_read(response, MESSAGE_LIMIT))
                for chunk in response.iter_bytes():
                    for event in parser.feed(chunk):
                        yield event
            finally:
                response.close()


def _read(response: httpx.Response, limit: int) -> HttpAnswer:
    body = bytearray()
    for chunk in response.iter_bytes():
        body += chunk
        if len(body) > limit:
            raise TooLarge(f"The answer of {response.url} has more than {limit} bytes.", "Ask for less at once.")
    return HttpAnswer(response.status_code, str(response.url), response.headers, bytes(body))
