"""Errors of the REST API as RFC 9457 problem documents."""

from __future__ import annotations

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


def problem_response(error: PretouchError, headers: dict[str, str] | None = None) -> JSONResponse:
    """`error` as an RFC 9457 problem document."""
    extra = dict(headers or {})
    if isinstance(error, Unauthenticated):
        extra["WWW-Authenticate"] = "Bearer"
    return JSONResponse(problem(error), wire_of(error).http_status, extra, media_type=PROBLEM_TYPE)


def answer_errors_as_problems(app: FastAPI, context: ServiceContext) -> None:
    """Every error of `app`, of its framework too, becomes a problem document."""

    async def known(_: Request, error: PretouchError) -> JSONResponse:
        if isinstance(error, Internal):
            context.log.error("a request met a defect", exc_info=error)
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
