"""The REST API follows its OpenAPI document for any input: no 500, and every error is a problem document."""

from __future__ import annotations

import json
from typing import Any

import httpx
import numpy as np
import pytest
import schemathesis
from helpers.box_session import DEPTH, MASK, ROOMY, request
from helpers.fake_upstream import DEVICE
from helpers.problems import TIMEOUT
from helpers.processes import Orchestrator
from helpers.scenes import Box, View, World
from hypothesis import HealthCheck, given, settings
from pretouch_orchestrator.rest import examples
from schemathesis import GenerationMode
from schemathesis.checks import CHECKS, load_all_checks, response_schema_conformance
from schemathesis.transport.serialization import Binary

from pretouch.client import RestClient
from pretouch.client.images import encode_depth, encode_mask
from pretouch.session import Budget, Session
from pretouch.wire.json import request_from_json

load_all_checks()
schemathesis.serializer.alias("application/x-ndjson", "text/plain")
_LEFT_OUT = {
    "ignored_auth",  # the token has its own test
    "positive_data_acceptance",  # a request can fit the schema and still not fit its image
    "negative_data_rejection",  # what the schema leaves out, such as unknown query parameters, may be let pass
    "missing_required_header",
}
_KEPT_CHECKS = [
    check for check in (CHECKS.get_one(name) for name in CHECKS.get_all_names()) if check.__name__ not in _LEFT_OUT
]


@pytest.fixture(scope="module")
def ended(orchestrator: Orchestrator) -> Session:
    """A session that was cancelled before its first scan: its events come to an end."""
    with RestClient(orchestrator.rest_url) as client:
        session = client.create_session(request(), DEPTH, MASK)
        client.cancel(session.id)
    return session


def test_the_api_keeps_to_its_description(ended: Session, orchestrator: Orchestrator) -> None:
    document = httpx.get(f"{orchestrator.rest_url}/openapi.json", timeout=TIMEOUT, trust_env=False).json()
    operations = [found.ok() for found in schemathesis.openapi.from_dict(document).get_all_operations()]
    assert len(operations) >= 10
    for operation in operations:
        modes = list(GenerationMode) if len(operation.body) or len(operation.query) else [GenerationMode.POSITIVE]
        for mode in modes:
            _explore(operation.as_strategy(generation_mode=mode), orchestrator.rest_url, ended)


def _explore(cases: Any, url: str, ended: Session) -> None:
    @given(case=cases)
    @settings(max_examples=12, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck), database=None)
    def explore(case: schemathesis.Case) -> None:
        _check(case, url)
        if _made_to_fit(case, url, ended):
            _check(case, url)

    explore()


def _made_to_fit(case: schemathesis.Case, url: str, ended: Session) -> bool:
    """Lets the case get further: it names a session that is there, and its images are of the right kind."""
    if "scan_id" in case.path_parameters:
        with RestClient(url) as client:
            session = client.create_session(request(budget=Budget(**ROOMY)), DEPTH, MASK)
        assert session.next_scan is not None
        case.path_parameters |= {"session_id": session.id, "scan_id": session.next_scan.scan_id}
    elif "session_id" in case.path_parameters:
        case.path_parameters["session_id"] = ended.id
    elif "name" in case.path_parameters:
        case.path_parameters["name"] = DEVICE
    elif isinstance(case.body, dict) and "depth" in case.body:
        case.body["depth"] = Binary(encode_depth(DEPTH)[0])
        case.body["mask"] = Binary(encode_mask(MASK)[0])
    else:
        return False
    return True


def _check(case: schemathesis.Case, url: str) -> None:
    response = case.call(base_url=url, timeout=TIMEOUT)
    assert response.status_code < 500 or response.status_code == 503, response.text
    if response.status_code >= 400:
        assert response.headers["content-type"] == ["application/problem+json"]
        document = response.json()
        assert document["status"] == response.status_code
        assert all(document[name] for name in ("type", "title", "detail", "remedy")), document
    stream = response.headers.get("content-type", [""])[0].startswith("text/event-stream")
    left_out = [response_schema_conformance] if stream else []  # it reads each event as the schema's value
    case.validate_response(response, checks=_KEPT_CHECKS, excluded_checks=left_out)


@pytest.mark.parametrize("example", [examples.MINIMAL_REQUEST, examples.COMPLETE_REQUEST], ids=["minimal", "complete"])
def test_the_example_of_a_request_creates_a_session(example: dict[str, Any], orchestrator: Orchestrator) -> None:
    asked = request_from_json(example)
    box = Box.standing((0.08, 0.06, 0.05), at=(0.45, 0.0))
    image, mask = World((box,)).depth(View(asked.base_T_camera, asked.camera, width=640, height=480))
    depth = np.round(image.metres / (asked.depth_scale or 0.001)).astype(np.uint16)
    files = {
        "request": ("request.json", json.dumps(example), "application/json"),
        "depth": ("depth.png", *encode_depth(depth)),
        "mask": ("mask.png", *encode_mask(mask)),
    }
    answer = httpx.post(f"{orchestrator.rest_url}/v1/sessions", files=files, timeout=TIMEOUT, trust_env=False)
    assert answer.status_code == 201, answer.text
    assert answer.json()["state"] == "awaiting_scan"
