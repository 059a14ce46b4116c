"""Admission of REST requests: checks host, origin and token, and logs and counts every request."""

from __future__ import annotations

import time

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from pretouch.errors import Forbidden
from pretouch.serving import ServiceContext
from pretouch.serving.caller import Caller, forbid_change, set_caller
from pretouch_orchestrator.rest.hosts import HostCheck, is_same_origin
from pretouch_orchestrator.rest.login import (
    LOGIN_PATH,
    LOGOUT_PATH,
    get_cookie_authorization,
    redirect_to_login,
    wants_page,
)
from pretouch_orchestrator.rest.problems import build_problem_response

OPEN_PATHS = ("/healthz", "/readyz")
"""Paths that need no token."""
METRICS_PATH = "/metrics"
_QUIET_PATHS = (*OPEN_PATHS, METRICS_PATH)
"""Paths that are polled every few seconds and therefore not logged."""


class AdmissionMiddleware:
    """Passes requests that come by an allowed name and carry a token to `app`, and logs and counts all of them."""

    def __init__(self, app: ASGIApp, context: ServiceContext, hosts: HostCheck) -> None:
        self._app = app
        self._hosts = hosts
        self._token_check = context.token_check
        self._open_paths = {*OPEN_PATHS, LOGIN_PATH, LOGOUT_PATH}
        if context.settings.open_metrics:
            self._open_paths.add(METRICS_PATH)
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
            app = self._find_refusal(scope) or self._app
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

    def _find_refusal(self, scope: Scope) -> ASGIApp | None:
        """The answer to a request that may not pass; None, and its caller known, if it may."""
        foreign = self._hosts.find_refusal(scope)
        if foreign is not None:
            return build_problem_response(foreign)
        if scope["path"] in self._open_paths:
            set_caller(Caller(read_only=True))
            return None
        headers = dict(scope["headers"])
        authorization = headers.get(b"authorization", b"")
        by_cookie = not authorization
        if by_cookie:
            authorization = get_cookie_authorization(scope)
        caller = self._token_check.identify(authorization)
        if caller is None:
            if wants_page(scope):
                return redirect_to_login(scope)
            address = scope["client"][0] if scope["client"] else ""
            return build_problem_response(self._token_check.refuse(authorization, address))
        if scope["method"] not in ("GET", "HEAD"):
            if caller.read_only:
                return build_problem_response(forbid_change())
            origin, host = headers.get(b"origin", b""), headers.get(b"host", b"")
            if by_cookie and authorization and not is_same_origin(origin.decode("latin-1"), host.decode("latin-1")):
                return build_problem_response(
                    Forbidden("A cookie alone may change nothing.", "Send the token as `Authorization: Bearer TOKEN`.")
                )
        set_caller(caller)
        return None
