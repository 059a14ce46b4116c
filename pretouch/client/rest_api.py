"""The session API over REST: calls as HTTP requests."""

from __future__ import annotations

import json
import uuid
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import quote

import httpx

from pretouch.client.api import Call, ResultT, SessionApi, SessionPage
from pretouch.client.images import ImageLike, encode_depth, encode_mask
from pretouch.errors import WIRE, DeadlineExceeded, Internal, InvalidInput, PretouchError, Unavailable, from_problem
from pretouch.session import ScanPlan, ScanProgress, Session, SessionRequest, Submission, Telling
from pretouch.wire.json import (
    progress_from_json,
    request_to_json,
    scan_plan_from_json,
    session_from_json,
    session_page_from_json,
    submission_to_json,
    telling_to_json,
)


@dataclass(frozen=True)
class HttpMessage:
    """A request; `options` are further arguments of `httpx.Client.request`."""

    method: str
    path: str
    options: dict[str, Any] = field(default_factory=dict)


class RestSessionApi(SessionApi[HttpMessage, httpx.Response]):
    """The REST contract, version 1."""

    def create_session(
        self, request: SessionRequest, depth: ImageLike, mask: ImageLike | None, idempotency_key: str | None
    ) -> Call[HttpMessage, httpx.Response, Session]:
        files = {
            "request": ("request.json", json.dumps(request_to_json(request)).encode(), "application/json"),
            "depth": ("depth", *encode_depth(depth)),
        }
        if mask is not None:
            files["mask"] = ("mask", *encode_mask(mask))
        headers = {"Idempotency-Key": idempotency_key or uuid.uuid4().hex}
        message = HttpMessage("POST", "/v1/sessions", {"files": files, "headers": headers})
        return Call(message, _decode_with(session_from_json))

    def session(self, session_id: str) -> Call[HttpMessage, httpx.Response, Session]:
        return Call(HttpMessage("GET", session_path(session_id)), _decode_with(session_from_json))

    def sessions(self, limit: int, cursor: str) -> Call[HttpMessage, httpx.Response, SessionPage]:
        params: dict[str, Any] = {"limit": limit} | ({"cursor": cursor} if cursor else {})
        return Call(
            HttpMessage("GET", "/v1/sessions", {"params": params}),
            _decode_with(lambda document: SessionPage(*session_page_from_json(document))),
        )

    def next_scan(self, session_id: str) -> Call[HttpMessage, httpx.Response, ScanPlan]:
        return Call(HttpMessage("GET", session_path(session_id) + "/next-scan"), _decode_with(scan_plan_from_json))

    def submit(
        self, session_id: str, scan_id: str, submission: Submission
    ) -> Call[HttpMessage, httpx.Response, Session]:
        message = HttpMessage("POST", _scan_path(session_id, scan_id), {"json": submission_to_json(submission)})
        return Call(message, _decode_with(session_from_json))

    def tell(self, session_id: str, scan_id: str, telling: Telling) -> Call[HttpMessage, httpx.Response, ScanProgress]:
        path = f"{_scan_path(session_id, scan_id)}/samples"
        return Call(HttpMessage("POST", path, {"json": telling_to_json(telling)}), _decode_with(progress_from_json))

    def cancel(self, session_id: str, purge: bool) -> Call[HttpMessage, httpx.Response, None]:
        options = {"params": {"purge": "true"}} if purge else {}
        return Call(HttpMessage("DELETE", session_path(session_id), options), raise_for_problem)


def session_path(session_id: str) -> str:
    return f"/v1/sessions/{quote(session_id, safe='')}"


def _scan_path(session_id: str, scan_id: str) -> str:
    return f"{session_path(session_id)}/scans/{quote(scan_id, safe='')}"


def raise_for_problem(response: httpx.Response) -> None:
    """Raises the pretouch error that a response with an error status stands for."""
    if response.is_success:
        return
    if response.headers.get("content-type", "").startswith("application/problem+json"):
        document = _parse_json(response)
        if isinstance(document, dict):
            raise from_problem(document)
    status = response.status_code
    kind: type[PretouchError] = Unavailable if status == 502 else Internal
    for known, wire in WIRE.items():
        if wire.http_status == status:
            kind = known
    raise kind(
        f"{response.url} answered {status} {response.reason_phrase} without a problem document.",
        "Check that the address is that of a pretouch orchestrator, and any proxy in between.",
    )


def convert_transport_error(error: httpx.TransportError, base_url: str) -> PretouchError:
    """Converts a failed connection to the pretouch error that it stands for."""
    if isinstance(error, httpx.TimeoutException) and not isinstance(error, httpx.ConnectTimeout):
        return DeadlineExceeded(f"{base_url} did not answer in time.", "Try again, or allow a longer timeout.")
    return Unavailable(
        f"{base_url} cannot be reached: {str(error) or type(error).__name__}.",
        "Check that the orchestrator runs at this address, and its TLS settings.",
    )


def _decode_with(parse: Callable[[object], ResultT]) -> Callable[[httpx.Response], ResultT]:
    def decode(response: httpx.Response) -> ResultT:
        raise_for_problem(response)
        try:
            return parse(_parse_json(response))
        except InvalidInput as error:
            raise Internal(
                f"The answer of {response.url} cannot be read: {error.detail}",
                "Check that the address is that of a pretouch orchestrator, and that the client is as new.",
            ) from error

    return decode


def _parse_json(response: httpx.Response) -> object:
    try:
        return response.json()
    except ValueError as error:
        raise Internal(
            f"The answer of {response.url} is not JSON.", "Check that the address is that of a pretouch orchestrator."
        ) from error
