"""The session API over REST: calls as HTTP requests."""

from __future__ import annotations

import json
import time
import uuid
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from email.utils import parsedate_to_datetime
from typing import Any

from pretouch.calibrated_camera import CalibratedCamera, CameraSummary
from pretouch.channel import MESSAGE_LIMIT
from pretouch.client.api import Call, ResultT, SessionApi, SessionPage
from pretouch.client.arguments import check_id, check_key
from pretouch.client.images import ImageLike, encode_depth, encode_mask
from pretouch.errors import WIRE, Internal, InvalidInput, Unavailable, from_problem
from pretouch.session import ScanPlan, ScanProgress, Session, SessionRequest, Submission, Telling
from pretouch.tracing import propagated
from pretouch.wire.json import (
    camera_from_json,
    camera_list_from_json,
    progress_from_json,
    request_to_json,
    scan_plan_from_json,
    session_from_json,
    session_page_from_json,
    submission_to_json,
    telling_to_json,
)

_LARGEST_RECORDING = 128 * 1024 * 1024
"""Bytes: several times as many as the longest session's."""


@dataclass(frozen=True)
class HttpMessage:
    """A request.

    Attributes:
        options: further arguments of `httpx.Client.request`.
        limit: bytes that the answer may have.
    """

    method: str
    path: str
    options: dict[str, Any] = field(default_factory=dict)
    limit: int = MESSAGE_LIMIT


@dataclass(frozen=True)
class HttpAnswer:
    """A response whose body was read; `headers` by their names in lower case."""

    status: int
    url: str
    headers: Mapping[str, str]
    body: bytes


class RestSessionApi(SessionApi[HttpMessage, HttpAnswer]):
    """The REST contract, version 1."""

    def create_session(
        self, request: SessionRequest, depth: ImageLike, mask: ImageLike | None, idempotency_key: str | None
    ) -> Call[HttpMessage, HttpAnswer, Session]:
        files = {
            "request": ("request.json", json.dumps(request_to_json(request)).encode(), "application/json"),
            "depth": ("depth", *encode_depth(depth)),
        }
        if mask is not None:
            files["mask"] = ("mask", *encode_mask(mask))
        headers = {"Idempotency-Key": check_key(idempotency_key) or uuid.uuid4().hex}
        message = HttpMessage("POST", "/v1/sessions", {"files": files, "headers": headers})
        return Call(message, _decode_with(session_from_json))

    def session(self, session_id: str) -> Call[HttpMessage, HttpAnswer, Session]:
        return Call(HttpMessage("GET", session_path(session_id)), _decode_with(session_from_json))

    def sessions(self, limit: int, cursor: str) -> Call[HttpMessage, HttpAnswer, SessionPage]:
        params: dict[str, Any] = {"limit": limit} | ({"cursor": cursor} if cursor else {})
        return Call(
            HttpMessage("GET", "/v1/sessions", {"params": params}),
            _decode_with(lambda document: SessionPage(*session_page_from_json(document))),
        )

    def next_scan(self, session_id: str) -> Call[HttpMessage, HttpAnswer, ScanPlan]:
        return Call(HttpMessage("GET", session_path(session_id) + "/next-scan"), _decode_with(scan_plan_from_json))

    def submit(self, session_id: str, scan_id: str, submission: Submission) -> Call[HttpMessage, HttpAnswer, Session]:
        message = HttpMessage("POST", _scan_path(session_id, scan_id), {"json": submission_to_json(submission)})
        return Call(message, _decode_with(session_from_json))

    def tell(self, session_id: str, scan_id: str, telling: Telling) -> Call[HttpMessage, HttpAnswer, ScanProgress]:
        path = f"{_scan_path(session_id, scan_id)}/samples"
        return Call(HttpMessage("POST", path, {"json": telling_to_json(telling)}), _decode_with(progress_from_json))

    def cancel(self, session_id: str, purge: bool) -> Call[HttpMessage, HttpAnswer, None]:
        options = {"params": {"purge": "true"}} if purge else {}
        return Call(HttpMessage("DELETE", session_path(session_id), options), raise_for_problem)

    def cameras(self) -> Call[HttpMessage, HttpAnswer, tuple[CameraSummary, ...]]:
        return Call(HttpMessage("GET", "/v1/cameras"), _decode_with(camera_list_from_json))

    def camera(self, camera_id: str) -> Call[HttpMessage, HttpAnswer, CalibratedCamera]:
        return Call(HttpMessage("GET", _camera_path(camera_id)), _decode_with(camera_from_json))

    def forget_camera(self, camera_id: str) -> Call[HttpMessage, HttpAnswer, None]:
        return Call(HttpMessage("DELETE", _camera_path(camera_id)), raise_for_problem)


def with_trace(message: HttpMessage) -> dict[str, Any]:
    """The message's options, with the headers of the current span."""
    return message.options | {"headers": propagated() | message.options.get("headers", {})}


def session_path(session_id: str) -> str:
    return f"/v1/sessions/{check_id('session', session_id)}"


def report_call(session_id: str) -> Call[HttpMessage, HttpAnswer, bytes]:
    """The session's report, which only REST offers."""
    message = HttpMessage("GET", session_path(session_id) + "/report", {"headers": {"Accept": "text/html"}})
    return Call(message, _read_page)


def recording_call(session_id: str) -> Call[HttpMessage, HttpAnswer, bytes]:
    """The session's recording, which only REST offers."""
    message = HttpMessage("GET", session_path(session_id) + "/recording.mcap", limit=_LARGEST_RECORDING)
    return Call(message, _read_recording)


def _scan_path(session_id: str, scan_id: str) -> str:
    return f"{session_path(session_id)}/scans/{check_id('scan', scan_id)}"


def _camera_path(camera_id: str) -> str:
    return f"/v1/cameras/{check_id('camera', camera_id)}"


def raise_for_problem(answer: HttpAnswer) -> None:
    """Raises the pretouch error that an answer with an error status stands for."""
    status = answer.status
    if 200 <= status < 300:
        return
    if answer.headers.get("content-type", "").startswith("application/problem+json"):
        document = _parse_json(answer.body)
        if isinstance(document, dict):
            raise from_problem(document)
    kinds = {wire.http_status: kind for kind, wire in WIRE.items()} | {408: Unavailable, 502: Unavailable}
    error = kinds.get(status, Internal)(
        f"{answer.url} answered {status} without a problem document.",
        "Check that the address is that of a pretouch orchestrator, and any proxy in between.",
    )
    error.retry_after = read_retry_after(answer.headers.get("retry-after", ""))
    raise error


def read_retry_after(text: str) -> float | None:
    """s that a header `Retry-After` names, as a number or as a date; None if it names none."""
    if text.isascii() and text.isdigit() and len(text) < 9:
        return float(text)
    try:
        return max(parsedate_to_datetime(text).timestamp() - time.time(), 0.0)
    except (TypeError, ValueError, OverflowError):
        return None


def _read_page(answer: HttpAnswer) -> bytes:
    raise_for_problem(answer)
    if not answer.headers.get("content-type", "").startswith("text/html"):
        raise Internal(
            f"The answer of {answer.url} is not HTML.", "Check that the address is that of a pretouch orchestrator."
        )
    return answer.body


def _read_recording(answer: HttpAnswer) -> bytes:
    raise_for_problem(answer)
    if not answer.body.startswith(b"\x89MCAP"):
        raise Internal(
            f"The answer of {answer.url} is no MCAP file.", "Check that the address is that of a pretouch orchestrator."
        )
    return answer.body


def _decode_with(parse: Callable[[object], ResultT]) -> Callable[[HttpAnswer], ResultT]:
    def decode(answer: HttpAnswer) -> ResultT:
        raise_for_problem(answer)
        document = _parse_json(answer.body)
        if document is None:
            raise Internal(
                f"The answer of {answer.url} is not JSON.",
                "Check that the address is that of a pretouch orchestrator.",
            )
        try:
            return parse(document)
        except InvalidInput as error:
            raise Internal(
                f"The answer of {answer.url} cannot be read: {error.detail}",
                "Check that the address is that of a pretouch orchestrator, and that the client is as new.",
            ) from error

    return decode


def _parse_json(body: bytes) -> object:
    """The document; None if it is not JSON."""
    try:
        return json.loads(body)
    except (ValueError, RecursionError):
        return None
