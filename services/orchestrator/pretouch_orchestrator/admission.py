"""What stands before every REST route: token, size limit, metrics; and the problem documents that errors become."""

from __future__ import annotations

import hmac
import time
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException
from starlette.routing import Match

from pretouch.errors import (
    WIRE,
    Internal,
    InvalidInput,
    Malformed,
    MethodNotAllowed,
    NotFound,
    PretouchError,
    TooLarge,
    Unauthenticated,
    problem,
    wire_of,
)
from pretouch.serving import Kit
from pretouch_orchestrator.bodies import MAX_BODY

OPEN_PATHS = ("/healthz", "/readyz")
"""Paths that need no token."""
_QUIET_PATHS = (*OPEN_PATHS, "/metrics")
"""Paths that machines ask for every few seconds: not in the log."""
PROBLEM_TYPE = "application/problem+json"

_Message = MutableMapping[str, Any]
_Receive = Callable[[], Awaitable[_Message]]
_Send = Callable[[_Message], Awaitable[None]]
_App = Callable[[MutableMapping[str, Any], _Receive, _Send], Awaitable[None]]


class Admission:
    """Lets a request through to `app` if it carries the token and its body keeps within MAX_BODY, and counts it."""

    def __init__(self, app: _App, kit: Kit) -> None:
        self._app = app
        self._token = None if kit.settings.token is None else f"Bearer {kit.settings.token}".encode()
        self._log = kit.log
        self._requests = kit.metrics.counter("http_requests", "REST requests that ended.", ("route", "status"))
        self._seconds = kit.metrics.histogram("http_request_seconds", "Duration of REST requests.", ("route",))

    async def __call__(self, scope: MutableMapping[str, Any], receive: _Receive, send: _Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        began = time.perf_counter()
        status = 0

        async def send_noting(message: _Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
            await send(message)

        try:
            headers = dict(scope["headers"])
            if (refusal := self._refusal(scope["path"], headers)) is not None:
                await problem_response(refusal)(scope, receive, send_noting)
            else:
                await self._app(scope, _Limited(receive), send_noting)
        finally:
            seconds = time.perf_counter() - began
            route = getattr(scope.get("route"), "path", "none")
            self._requests.labels(route, status).inc()
            self._seconds.labels(route).observe(seconds)
            if scope["path"] not in _QUIET_PATHS:
                self._log.info(
                    "request", method=scope["method"], path=scope["path"], status=status, seconds=round(seconds, 6)
                )

    def _refusal(self, path: str, headers: dict[bytes, bytes]) -> PretouchError | None:
        given = headers.get(b"authorization", b"")
        if self._token is not None and path not in OPEN_PATHS and not hmac.compare_digest(given, self._token):
            return Unauthenticated(
                "The request carries a wrong token." if given else "The request carries no token.",
                "Send `Authorization: Bearer TOKEN` with the token that the service was started with.",
            )
        length = headers.get(b"content-length", b"0")
        return _too_large() if length.isdigit() and int(length) > MAX_BODY else None


class _Limited:
    """Receives a body and stops at the limit, however long it claims to be."""

    def __init__(self, receive: _Receive) -> None:
        self._receive = receive
        self._left = MAX_BODY

    async def __call__(self) -> _Message:
        message = await self._receive()
        self._left -= len(message.get("body", b""))
        if self._left < 0:
            raise _too_large()
        return message


def _too_large() -> TooLarge:
    return TooLarge(f"The body is larger than {MAX_BODY} bytes.", "Crop the image, or thin out the scan.")


def problem_response(error: PretouchError, headers: dict[str, str] | None = None) -> JSONResponse:
    """`error` as an RFC 9457 problem document."""
    extra = dict(headers or {})
    if isinstance(error, Unauthenticated):
        extra["WWW-Authenticate"] = "Bearer"
    return JSONResponse(problem(error), wire_of(error).http_status, extra, media_type=PROBLEM_TYPE)


def answer_errors_as_problems(app: FastAPI, kit: Kit) -> None:
    """Every error of `app`, of its framework too, becomes a problem document."""

    async def known(_: Request, error: PretouchError) -> JSONResponse:
        if isinstance(error, Internal):
            kit.log.error("a request met a defect", exc_info=error)
        return problem_response(error)

    async def of_framework(request: Request, error: HTTPException) -> JSONResponse:
        path, method = request.url.path, request.method
        headers = dict(error.headers or {})
        match error.status_code:
            case 404:
                return problem_response(NotFound(f"There is nothing at {path!r:.200}.", "See /docs for what there is."))
            case 405:
                headers["Allow"] = _allowed(request)
                return problem_response(
                    MethodNotAllowed(f"{path!r:.200} does not know {method!r:.20}.", f"Use {headers['Allow']}."),
                    headers,
                )
            case status:
                kinds = {wire.http_status: kind for kind, wire in WIRE.items()}
                kind = kinds.get(status, Malformed if status < 500 else Internal)
                return problem_response(kind(str(error.detail), "See /docs for what is expected."), headers)

    async def of_parameters(_: Request, error: RequestValidationError) -> JSONResponse:
        first = error.errors()[0]
        name = ".".join(str(part) for part in first["loc"][1:])
        return problem_response(InvalidInput(f"{name}: {first['msg']}.", "See /docs for what is expected."))

    async def of_defect(_: Request, error: Exception) -> JSONResponse:
        return problem_response(
            Internal("The service met a defect of its own.", "Report it with the service's log of this moment.")
        )

    app.add_exception_handler(PretouchError, known)  # type: ignore[arg-type]
    app.add_exception_handler(HTTPException, of_framework)  # type: ignore[arg-type]
    app.add_exception_handler(RequestValidationError, of_parameters)  # type: ignore[arg-type]
    app.add_exception_handler(Exception, of_defect)


def _allowed(request: Request) -> str:
    """The methods of all routes at the request's path; the framework's own error names those of the first."""
    routes = [route for route in request.app.routes if route.matches(request.scope)[0] is not Match.NONE]
    return ", ".join(sorted({method for route in routes for method in getattr(route, "methods", ())}))
