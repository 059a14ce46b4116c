"""The OpenAPI document of the orchestrator, without one that runs."""

from __future__ import annotations

from typing import Any

from pretouch_orchestrator.rest.app import create_rest_app

from pretouch.serving import ServiceContext, Settings


def openapi_document(token: str | None = None) -> dict[str, Any]:
    """As `/openapi.json` answers it, by an orchestrator with this token."""
    context = ServiceContext("orchestrator", Settings(token=token))
    document = create_rest_app(None, context, None).openapi()  # type: ignore[arg-type]
    context.close()
    return document
