"""Errors of the REST API as RFC 9457 problem documents."""

from __future__ import annotations

import math

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
    Unauthenticated,
    problem,
    wire_of,
)
from pretouch.serving import ServiceContext

PROBLEM_TYPE = "application/problem+json"


def build_problem_response(error: PretouchError, headers: dict[str, str] | None = None) -> JSONResponse:
    """`error` as an RFC 9457 problem document."""
    extra = dict(headers or {})
    if isinstance(error, Unauthenticated):
        extra["WWW-Authenticate"] = "Bearer"
    document = problem(error)
    if "retry_after" in document:
        extra["Retry-After"] = str(math.ceil(document["retry_after"]))
    return JSONResponse(document, wire_of(error).http_status, extra, media_type=PROBLEM_TYPE)


def answer_errors_as_problems(app: FastAPI, context: ServiceContext) -> None:
    """Makes `app` answer all errors, those of the framework included, as problem documents."""

    async def handle_pretouch_error(_: Request, error: PretouchError) -> JSONResponse:
        if isinstance(error, Internal):
            context.log.error("a request met a defect", exc_info=error)
        return build_problem_response(error)

    async def handle_http_error(request: Request, error: HTTPException) -> JSONResponse:
        path, method = request.url.path, request.method
        headers = dict(error.headers or {})
        match error.status_code:
            case 404:
                return build_problem_response(
                    NotFound(f"There is nothing at {path!r:.200}.", "See /docs for what there is.")
                )
            case 405:
                headers["Allow"] = _find_allowed_methods(request)
                return build_problem_response(
                    MethodNotAllowed(f"{path!r:.200} does not support {method!r:.20}.", f"Use {headers['Allow']}."),
                    headers,
                )
            case status:
                kinds = {wire.http_status: kind for kind, wire in WIRE.items()}
                kind = kinds.get(status, Malformed if status < 500 else Internal)
                return build_problem_response(kind(str(error.detail), "See /docs for what is expected."), headers)

    async def handle_invalid_parameter(_: Request, error: RequestValidationError) -> JSONResponse:
        first = error.errors()[0]
        name = ".".join(str(part) for part in first["loc"][1:])
        return build_problem_response(InvalidInput(f"{name}: {first['msg']}.", "See /docs for what is expected."))

    async def handle_defect(_: Request, error: Exception) -> JSONResponse:
        return build_problem_response(
            Internal("The service met a defect of its own.", "Report it with the service's log of this moment.")
        )

    app.add_exception_handler(PretouchError, handle_pretouch_error)  # type: ignore[arg-type]
    app.add_exception_handler(HTTPException, handle_http_error)  # type: ignore[arg-type]
    app.add_exception_handler(RequestValidationError, handle_invalid_parameter)  # type: ignore[arg-type]
    app.add_exception_handler(Exception, handle_defect)


def _find_allowed_methods(request: Request) -> str:
    """The methods of all routes at the request's path; the framework's own error names only those of the first."""
    routes = [route for route in request.app.routes if route.matches(request.scope)[0] is not Match.NONE]
    methods = {method for route in routes for method in getattr(route, "methods", ())}
    return ", ".join(sorted(methods | ({"HEAD"} if "GET" in methods else set())))
