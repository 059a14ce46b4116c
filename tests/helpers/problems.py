"""Sends arbitrary input to the orchestrator, as raw HTTP and raw protobuf, and reads the problem in the response."""

from __future__ import annotations

import json
from typing import Any

import grpc
import httpx
from google.protobuf.message import Message

from helpers.processes import Orchestrator
from pretouch.channel import open_sync_channel
from pretouch.errors import PROBLEM_METADATA_KEY, PretouchError, problem, wire_of
from pretouch.v1.orchestrator_pb2_grpc import OrchestratorServiceStub

TIMEOUT = 60.0


def over_rest(
    orchestrator: Orchestrator, method: str, path: str, **options: Any
) -> tuple[dict[str, Any], httpx.Headers]:
    """The problem document that a request is refused with, and the headers."""
    response = httpx.request(method, orchestrator.rest_url + path, timeout=TIMEOUT, trust_env=False, **options)
    assert response.is_error, response.text
    assert response.headers["content-type"] == "application/problem+json"
    document = response.json()
    assert document["status"] == response.status_code
    return document, response.headers


def over_grpc(
    orchestrator: Orchestrator, method: str, request: Message, metadata: Any = None
) -> tuple[dict[str, Any], grpc.StatusCode]:
    """The problem document that a call is refused with, and its status code."""
    with open_sync_channel(orchestrator.address) as channel:
        try:
            getattr(OrchestratorServiceStub(channel), method)(request, timeout=TIMEOUT, metadata=metadata)
        except grpc.RpcError as error:
            for key, value in error.trailing_metadata():
                if key == PROBLEM_METADATA_KEY:
                    return json.loads(value), error.code()
            raise AssertionError(f"{error.code()} came without a problem document: {error.details()}") from error
    raise AssertionError("The call was not refused.")


def check(document: dict[str, Any], kind: type[PretouchError], word: str = "") -> None:
    """`document` is a problem of just this `kind`, says what was wrong (with `word` in it) and what to do."""
    expected = problem(kind("", ""))
    assert {name: document[name] for name in ("type", "title", "status")} == {
        name: expected[name] for name in ("type", "title", "status")
    }, document
    assert set(document) | {"retry_after"} == set(expected) | {"retry_after"}
    assert len(document["detail"]) > 10, document
    assert len(document["remedy"]) > 3, document
    assert word.lower() in document["detail"].lower(), document
    for leak in ("Traceback", 'File "', "site-packages", "Error:"):
        assert leak not in json.dumps(document)


def code_of(kind: type[PretouchError]) -> grpc.StatusCode:
    """The gRPC status code that stands for `kind`."""
    return wire_of(kind("", "")).grpc_code
