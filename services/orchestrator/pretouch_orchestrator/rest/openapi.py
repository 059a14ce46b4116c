"""Describes the REST routes in OpenAPI: request bodies, responses, problems and how calls are authenticated."""

from __future__ import annotations

import json
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic import BaseModel, TypeAdapter
from pydantic.json_schema import models_json_schema

from pretouch import __version__
from pretouch.errors import WIRE
from pretouch_orchestrator.rest import camera_examples, camera_models, device_models, examples, models
from pretouch_orchestrator.rest.admission import OPEN_PATHS
from pretouch_orchestrator.rest.bodies import PARTS
from pretouch_orchestrator.rest.problems import PROBLEM_TYPE

_REFERENCE = "#/components/schemas/{model}"
_REQUEST_MODELS = (models.SessionRequest, device_models.TipPose)
_RESPONSE_MODELS = (
    models.Session,
    models.SessionList,
    models.ScanPlan,
    models.ScanProgress,
    models.Problem,
    models.Health,
    models.Caller,
    models.ServiceList,
    *camera_models.MODELS,
    *device_models.MODELS,
)
_CHOICES: dict[str, tuple[Any, str]] = {
    "Submission": (models.Submission, "The result of a scan, in one of four forms."),
    "Telling": (models.Telling, "Samples of a scan under way, in one of two forms."),
}
"""Bodies of one of several forms, by the name of their schema."""
_BEARER = {
    "type": "http",
    "scheme": "bearer",
    "description": "The token that the orchestrator was started with, if any: `Authorization: Bearer TOKEN`.",
}
_TITLES = {wire.http_status: wire.title for wire in WIRE.values()}


def describe_json(model: type[BaseModel], description: str) -> dict[str, Any]:
    """A JSON response; the examples are those of the model."""
    return {"description": description, "content": {"application/json": {"schema": _refer_to(model)}}}


def describe_text(media_type: str, description: str, example: str) -> dict[str, Any]:
    """A response that is not JSON."""
    return {"description": description, "content": {media_type: {"schema": {"type": "string"}, "example": example}}}


def describe_responses(status: int, success: dict[str, Any], *problems: int) -> dict[int | str, dict[str, Any]]:
    """A route's successful response, and the statuses of its problem documents.

    By a foreign name every route is refused (403), and after many wrong tokens each that asks for one (429).
    """
    described: dict[int | str, dict[str, Any]] = {status: success}
    for code in sorted({*problems, 403, *((429,) if 401 in problems else ())}):
        content = {"schema": _refer_to(models.Problem), "example": examples.PROBLEMS[code]}
        described[code] = {"description": _TITLES[code], "content": {PROBLEM_TYPE: content}}
    return described


def describe_creation_body() -> dict[str, Any]:
    """The multipart body of a session's creation."""
    properties = {
        "request": _refer_to(models.SessionRequest) | {"description": "The request, without the images."},
        "depth": {
            "type": "string",
            "format": "binary",
            "description": "Depth along the camera's optical axis in units of `camera.depth_scale`; 0, NaN and the "
            "type's largest value mean no data. "
            "A 16-bit greyscale PNG, or an .npy file of uint16 or float32; h x w pixels, at most 4 million.",
        },
        "mask": {
            "type": "string",
            "format": "binary",
            "description": "Greyscale PNG of the depth image's size, non-zero in the pixels of the object; left out: "
            "the object is found on the table.",
        },
    }
    form = {"type": "object", "required": ["request", "depth"], "properties": properties, "additionalProperties": False}
    encoding = {name: {"contentType": ", ".join(PARTS[name][: 1 if name == "request" else None])} for name in PARTS}
    content = {"multipart/form-data": {"schema": form, "encoding": encoding}}
    return {"requestBody": {"required": True, "content": content}}


def describe_json_body(name: str) -> dict[str, Any]:
    """A JSON body of one of several forms, whose schema has this name."""
    schema = {"$ref": _REFERENCE.format(model=name)}
    return {"requestBody": {"required": True, "content": {"application/json": {"schema": schema}}}}


def describe_lines_body(model: type[BaseModel], media_type: str) -> dict[str, Any]:
    """A body of lines, each of which is a JSON document of the model; the example is of two."""
    lines = "".join(f"{json.dumps(document)}\n" for document in examples.DOCUMENTS[model.__name__] * 2)
    description = f"Lines, each of which is a JSON document: {model.__name__}."
    content = {media_type: {"schema": {"type": "string", "description": description}, "example": lines}}
    return {"requestBody": {"required": True, "content": content}}


def install_document(app: FastAPI, *, token: bool) -> None:
    """Gives `app` its OpenAPI document."""

    def get_document() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = _build_document(app, token)
        return app.openapi_schema

    app.openapi = get_document  # type: ignore[method-assign]


def _build_document(app: FastAPI, token: bool) -> dict[str, Any]:
    document = get_openapi(
        title=app.title,
        version=__version__,
        description=app.description,
        routes=app.routes,
        servers=[{"url": "/", "description": "The orchestrator that serves this document."}],
    )
    for methods in document["paths"].values():
        for operation in methods.values():
            # FastAPI adds a 422 to every route with parameters; the routes that can return one declare it themselves.
            if "application/json" in operation["responses"].get("422", {}).get("content", {}):
                del operation["responses"]["422"]
    inputs = [(model, "validation") for model in _REQUEST_MODELS]
    outputs = [(model, "serialization") for model in _RESPONSE_MODELS]
    _, definitions = models_json_schema([*inputs, *outputs], ref_template=_REFERENCE)  # type: ignore[list-item]
    schemas = dict(definitions["$defs"])
    for name, (forms, description) in _CHOICES.items():
        choice = TypeAdapter(forms).json_schema(ref_template=_REFERENCE)
        schemas |= choice.pop("$defs") | {name: choice | {"description": description}}
    for name, documents in (examples.DOCUMENTS | camera_examples.DOCUMENTS).items():
        schemas[name]["examples"] = documents
    components = {"schemas": dict(sorted(schemas.items())), "securitySchemes": {"bearer": _BEARER}}
    if token:
        document["security"] = [{"bearer": []}]
        for path in OPEN_PATHS:
            document["paths"][path]["get"]["security"] = []
    document["components"] = components
    return document


def _refer_to(model: type[BaseModel]) -> dict[str, str]:
    return {"$ref": _REFERENCE.format(model=model.__name__)}
