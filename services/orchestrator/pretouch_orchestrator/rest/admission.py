"""Admission of REST requests: checks the token, and logs and counts every request."""

from __future__ import annotations

import time

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from pretouch.serving import ServiceContext
from pretouch.serving.admission import TokenCheck
from pretouch_orchestrator.rest.problems import build_problem_response

OPEN_PATHS = ("/healthz", "/readyz")
"""Paths that need no token."""
_QUIET_PATHS = (*OPEN_PATHS, "/metrics")
"""Paths that are polled every few seconds and therefore not logged."""


class AdmissionMiddleware:
    """Passes requests that carry the token to `app`, and logs and counts all of them."""

    def __init__(self, app: ASGIApp, context: ServiceContext) -> None:
        self._app = app
        self._token_check = TokenCheck(context.settings.token)
        self._log = context.log
        self._requests = context.metrics.counter("http_requests", "REST requests that ended.", ("route", "status"))
        self._seconds = context.metrics.histogram("http_request_seconds", "Duration of REST requests.", ("route",))

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        began = time.perf_counter()
        status = 0

        async def send_and_note_status(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
            await send(message)

        try:
            refusal = None if scope["path"] in OPEN_PATHS else self._token_check.refusal(_get_authorization(scope))
            app = self._app if refusal is None else build_problem_response(refusal)
            await app(scope, receive, send_and_note_status)
        finally:
            seconds = time.perf_counter() - began
            route = getattr(scope.get("route"), "path", "none")
            self._requests.labels(route, status).inc()
            self._seconds.labels(route).observe(seconds)
            if scope["path"] not in _QUIET_PATHS:
                self._log.info(
                    "request", method=scope["method"], path=scope["path"], status=status, seconds=round(seconds, 6)
                )


def _get_authorization(scope: Scope) -> bytes:
    return bytes(dict(scope["headers"]).get(b"authorization", b""))
