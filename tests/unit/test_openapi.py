"""The OpenAPI document says what a client needs to know, and its examples fit it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from helpers.openapi_document import openapi_document
from jsonschema import Draft202012Validator
from pretouch_orchestrator.rest import examples

from pretouch.wire.json import request_from_json, session_from_json, submission_from_json

DOCUMENT = openapi_document(token="t")
OPERATIONS = {
    "create_session": "POST /v1/sessions",
    "list_sessions": "GET /v1/sessions",
    "get_session": "GET /v1/sessions/{session_id}",
    "cancel_session": "DELETE /v1/sessions/{session_id}",
    "get_next_scan": "GET /v1/sessions/{session_id}/next-scan",
    "submit_scan": "POST /v1/sessions/{session_id}/scans/{scan_id}",
    "tell_samples": "POST /v1/sessions/{session_id}/scans/{scan_id}/samples",
    "stream_events": "GET /v1/sessions/{session_id}/events",
    "get_report": "GET /v1/sessions/{session_id}/report",
    "get_recording": "GET /v1/sessions/{session_id}/recording.mcap",
    "list_cameras": "GET /v1/cameras",
    "get_camera": "GET /v1/cameras/{camera_id}",
    "forget_camera": "DELETE /v1/cameras/{camera_id}",
    "export_pose": "GET /v1/cameras/{camera_id}/export",
    "list_devices": "GET /v1/devices",
    "get_device": "GET /v1/devices/{name}",
    "send_poses": "POST /v1/devices/{name}/poses",
    "stream_ranges": "GET /v1/devices/{name}/ranges",
    "get_caller": "GET /v1/caller",
    "list_services": "GET /v1/services",
    "get_health": "GET /healthz",
    "get_readiness": "GET /readyz",
    "get_metrics": "GET /metrics",
    "get_docs": "GET /docs",
}


def operations() -> Iterator[tuple[str, dict[str, Any]]]:
    """Method and path, and the operation."""
    for path, methods in DOCUMENT["paths"].items():
        for method, operation in methods.items():
            yield f"{method.upper()} {path}", operation


def contents() -> Iterator[tuple[str, dict[str, Any]]]:
    """Every media type of every request and response, with the name of its operation."""
    for name, operation in operations():
        for message in (operation.get("requestBody", {}), *operation["responses"].values()):
            for content in message.get("content", {}).values():
                yield name, content


def properties() -> Iterator[tuple[str, dict[str, Any]]]:
    """Every property of every schema, with its name."""
    named = [*DOCUMENT["components"]["schemas"].items(), *((name, content["schema"]) for name, content in contents())]
    for owner, schema in named:
        for name, described in schema.get("properties", {}).items():
            yield f"{owner}: {name}", described


def errors(document: object, schema: dict[str, Any]) -> list[str]:
    """What of `document` does not fit `schema`."""
    validator = Draft202012Validator(schema | {"components": DOCUMENT["components"]})
    return [error.message for error in validator.iter_errors(document)]


def test_every_property_and_parameter_is_described() -> None:
    assert len(list(properties())) > 100
    assert [name for name, described in properties() if not described.get("description")] == []
    parameters = [parameter for _, operation in operations() for parameter in operation.get("parameters", ())]
    assert [parameter["name"] for parameter in parameters if not parameter.get("description")] == []


def test_operation_ids_are_stable() -> None:
    assert {operation["operationId"]: name for name, operation in operations()} == OPERATIONS


def test_calls_need_the_bearer_token_where_one_is_set() -> None:
    assert DOCUMENT["components"]["securitySchemes"]["bearer"]["scheme"] == "bearer"
    assert DOCUMENT["security"] == [{"bearer": []}]
    public = [name for name, operation in operations() if operation.get("security") == []]
    assert public == ["GET /healthz", "GET /readyz"]
    without = openapi_document()
    assert "security" not in without
    assert without["components"]["securitySchemes"] == DOCUMENT["components"]["securitySchemes"]


def test_the_server_is_the_one_that_answers() -> None:
    assert [server["url"] for server in DOCUMENT["servers"]] == ["/"]


def test_every_message_has_an_example_that_fits_it() -> None:
    for name, content in contents():
        schema = content["schema"]["properties"]["request"] if "encoding" in content else content["schema"]
        model = schema.get("$ref", "").rpartition("/")[2]
        given = [content["example"]] if "example" in content else DOCUMENT["components"]["schemas"][model]["examples"]
        assert given, name
        for example in given:
            assert errors(example, schema) == [], name


def test_a_message_that_does_not_fit_is_noticed() -> None:
    schema = {"$ref": "#/components/schemas/SessionRequest"}
    assert errors(examples.MINIMAL_REQUEST | {"scan": {"speed": "fast"}}, schema)
    assert errors({"camera": examples.MINIMAL_REQUEST["camera"]}, schema)


@pytest.mark.parametrize("kind", examples.SUBMISSIONS)
def test_the_example_of_a_scan_is_read(kind: str) -> None:
    submission_from_json(examples.SUBMISSIONS[kind])


def test_the_examples_of_requests_and_sessions_are_read() -> None:
    minimal = request_from_json(examples.MINIMAL_REQUEST)
    complete = request_from_json(examples.COMPLETE_REQUEST)
    assert (minimal.budget, minimal.sensor.rate) == (complete.budget, complete.sensor.rate)
    assert session_from_json(examples.CREATED).next_scan is not None
    assert session_from_json(examples.CONVERGED).state.ended
