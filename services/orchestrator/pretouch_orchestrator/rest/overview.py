"""The routes that tell a page or a program with what, and as whom, it speaks."""

from __future__ import annotations

from fastapi import FastAPI
from fastapi.responses import JSONResponse, Response

from pretouch import __version__
from pretouch.serving.caller import current_caller
from pretouch_orchestrator.readiness import Readiness
from pretouch_orchestrator.rest import models, openapi


def add_overview_routes(app: FastAPI, readiness: Readiness, *, token: bool) -> None:
    """Adds the routes; `token`: whether calls must carry one."""

    @app.get(
        "/v1/caller",
        summary="Who calls?",
        responses=openapi.describe_responses(200, openapi.describe_json(models.Caller, "The caller."), 401),
    )
    async def get_caller() -> Response:
        """Returns whose token the call carries, and whether it may change anything."""
        caller = current_caller()
        role = "read" if caller.read_only else "full"
        return JSONResponse({"owner": caller.owner, "role": role, "token": token})

    @app.get(
        "/v1/services",
        summary="List services",
        responses=openapi.describe_responses(
            200, openapi.describe_json(models.ServiceList, "What sessions need, and what is wrong with it."), 401
        ),
    )
    async def list_services() -> Response:
        """Lists what sessions need, the store and the other services, and what is wrong with each."""
        problems = await readiness.find_problems()
        services = [
            {"name": name, "ready": error is None, "problem": None if error is None else str(error)}
            for name, error in problems.items()
        ]
        return JSONResponse({"version": __version__, "services": services}, headers={"Cache-Control": "no-store"})
