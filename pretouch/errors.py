"""The errors of pretouch and how each crosses the wire.

    PretouchError
    ├── InvalidInput            422  a value is wrong in itself or against another one
    │   ├── Malformed           400  cannot be parsed, or a number is not finite
    │   ├── UnsupportedMedia    415  the body is of another type than asked for
    │   └── TooLarge            413  beyond a stated limit
    ├── Unauthenticated         401  no token, or a wrong one
    │   └── TooManyTries        429  many wrong tokens came from this address
    ├── Forbidden               403  the token, or where the request comes from, does not allow this
    ├── NotFound                404  no such session, scan, device or page
    │   └── UnknownScene        404  the registrar keeps no scene of this content hash: send the scene
    ├── MethodNotAllowed        405  the resource exists, the method does not
    ├── Conflict                409  the request does not fit the present state
    ├── Overloaded              429  every worker is busy: try again shortly
    ├── Internal                500  a defect of pretouch itself
    ├── Unavailable             503  a service, device or proposer cannot be reached or is not ready
    └── DeadlineExceeded        504  an answer did not come in time

Each error says in `detail` what was wrong and in `remedy` what to do about it; `Overloaded`, `Unavailable` and
`TooManyTries` say in `retry_after` when to try again.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any, ClassVar

import grpc

PROBLEM_METADATA_KEY = "pretouch-problem-bin"
"""Trailing metadata of a failed gRPC call: the RFC 9457 problem document as UTF-8 JSON."""


class PretouchError(Exception):
    """Base of all errors that pretouch raises on purpose.

    Args:
        detail: what was wrong, with the offending value.
        remedy: what the caller can do about it.
        retry_after: s after which the same call may succeed; None: the kind's own, `RETRY_AFTER`; infinite: waiting
            does not help.
    """

    RETRY_AFTER: ClassVar[float | None] = None

    def __init__(self, detail: str, remedy: str = "", retry_after: float | None = None) -> None:
        super().__init__(detail)
        self.detail = detail
        self.remedy = remedy
        self.retry_after = self.RETRY_AFTER if retry_after is None else retry_after


class InvalidInput(PretouchError):
    """A value is wrong in itself or against another one."""


class Malformed(InvalidInput):
    """Input cannot be parsed, or holds a number that is not finite."""


class UnsupportedMedia(InvalidInput):
    """The body or one of its parts is of another type than asked for."""


class TooLarge(InvalidInput):
    """Input is beyond a stated limit."""


class RefusedForSize(TooLarge):
    """A service is sent a larger message than gRPC lets through; repeating it will not help."""


class Unauthenticated(PretouchError):
    """The call carries no token, or a wrong one."""


class TooManyTries(Unauthenticated):
    """Many wrong tokens came from this address; a right one is still accepted."""

    RETRY_AFTER = 3.0


class Forbidden(PretouchError):
    """The token, or where the request comes from, does not allow this."""


class NotFound(PretouchError):
    """There is no such session, scan, device or page."""


class UnknownScene(NotFound):
    """The registrar keeps no scene of the content hash that it was sent."""


class MethodNotAllowed(PretouchError):
    """The resource exists but does not know the method."""


class Conflict(PretouchError):
    """The request does not fit the present state."""


class Overloaded(PretouchError):
    """Every worker is busy and the queue is full."""

    RETRY_AFTER = 1.0


class Unavailable(PretouchError):
    """A service, a device or a proposer cannot be reached or is not ready."""

    RETRY_AFTER = 1.0


class DeadlineExceeded(PretouchError):
    """An answer did not come in time."""


class Internal(PretouchError):
    """A defect of pretouch itself; the log has the trace, the wire never does."""


@dataclass(frozen=True)
class Wire:
    """How one kind of error crosses the wire."""

    slug: str
    title: str
    http_status: int
    grpc_code: grpc.StatusCode


_C = grpc.StatusCode
WIRE: dict[type[PretouchError], Wire] = {
    Malformed: Wire("malformed", "The request cannot be read", 400, _C.INVALID_ARGUMENT),
    UnsupportedMedia: Wire("unsupported-media", "The media type is not supported", 415, _C.INVALID_ARGUMENT),
    TooLarge: Wire("too-large", "The request is too large", 413, _C.RESOURCE_EXHAUSTED),
    InvalidInput: Wire("invalid-input", "The request is not valid", 422, _C.INVALID_ARGUMENT),
    Unauthenticated: Wire("unauthenticated", "The call is not authenticated", 401, _C.UNAUTHENTICATED),
    TooManyTries: Wire("too-many-tries", "Too many wrong tokens", 429, _C.RESOURCE_EXHAUSTED),
    Forbidden: Wire("forbidden", "The call is not allowed", 403, _C.PERMISSION_DENIED),
    NotFound: Wire("not-found", "Not found", 404, _C.NOT_FOUND),
    UnknownScene: Wire("unknown-scene", "The scene is not known", 404, _C.NOT_FOUND),
    MethodNotAllowed: Wire("method-not-allowed", "Method not allowed", 405, _C.UNIMPLEMENTED),
    Conflict: Wire("conflict", "The request conflicts with the present state", 409, _C.FAILED_PRECONDITION),
    Overloaded: Wire("overloaded", "The service is busy", 429, _C.RESOURCE_EXHAUSTED),
    Unavailable: Wire("unavailable", "Not available at present", 503, _C.UNAVAILABLE),
    DeadlineExceeded: Wire("deadline-exceeded", "The answer did not come in time", 504, _C.DEADLINE_EXCEEDED),
    Internal: Wire("internal", "An internal error", 500, _C.INTERNAL),
}
"""The one table: error -> problem slug, title, HTTP status and gRPC code."""

_BY_SLUG = {wire.slug: kind for kind, wire in WIRE.items()}
TYPE_PREFIX = "urn:pretouch:problem:"
"""What the `type` of every problem document begins with."""


def wire_of(error: PretouchError) -> Wire:
    """The row of the table for `error`, by its class or nearest base class."""
    for kind in type(error).__mro__:
        if kind in WIRE:
            return WIRE[kind]
    return WIRE[Internal]


def problem(error: PretouchError) -> dict[str, Any]:
    """The RFC 9457 problem document of `error`; `remedy` and `retry_after`, s, are our extension members."""
    wire = wire_of(error)
    document = {
        "type": TYPE_PREFIX + wire.slug,
        "title": wire.title,
        "status": wire.http_status,
        "detail": error.detail,
        "remedy": error.remedy,
    }
    if error.retry_after is None or math.isinf(error.retry_after):
        return document
    return document | {"retry_after": error.retry_after}


def from_problem(document: dict[str, Any]) -> PretouchError:
    """The error that `problem` wrote; an unknown type becomes `Internal`."""
    slug = str(document.get("type", "")).removeprefix(TYPE_PREFIX)
    kind = _BY_SLUG.get(slug, Internal)
    seconds = document.get("retry_after")
    if not isinstance(seconds, int | float) or not 0 <= seconds < 1e9:
        seconds = None if kind.RETRY_AFTER is None else math.inf
    detail = str(document.get("detail") or "The service did not say what was wrong.")
    return kind(detail, str(document.get("remedy", "")), None if seconds is None else float(seconds))


_UNREACHABLE = (
    "Check that the service runs at the given address, and TLS: with it or without it as the service, and with a "
    "client certificate if it asks for one. Then try again."
)


def unreachable(detail: str) -> Unavailable:
    """The error of a connection that cannot be made or broke; nobody said when to try again."""
    error = Unavailable(detail, _UNREACHABLE)
    error.retry_after = None
    return error


_REASON_LOST = "Internal error from Core"
"""What grpc.aio reports where it writes to a call that the service has just ended, in place of the service's reason."""


def from_rpc_error(error: grpc.RpcError) -> PretouchError:
    """The error behind a failed gRPC call: from its problem metadata, else from its status code."""
    metadata = error.trailing_metadata() if hasattr(error, "trailing_metadata") else None
    for key, value in metadata or ():
        if key == PROBLEM_METADATA_KEY and (document := _read_problem(value)) is not None:
            return from_problem(document)
    code = error.code() if hasattr(error, "code") else _C.UNKNOWN
    detail = (error.details() if hasattr(error, "details") else None) or str(error)
    if code in (_C.UNAVAILABLE, _C.CANCELLED):
        return unreachable(detail)
    if code is _C.INTERNAL and detail == _REASON_LOST:
        return Unavailable(
            "The service ended the call while it was still being sent messages.",
            "Call again: if something in them is wrong, the error then says what.",
        )
    if code is _C.RESOURCE_EXHAUSTED and "larger than max" not in detail:
        return Overloaded(detail, "Try again shortly.")
    for kind, wire in WIRE.items():
        if wire.grpc_code is code:
            return kind(detail)
    return Internal(f"{code}: {detail}")


def _read_problem(value: bytes) -> dict[str, Any] | None:
    """The problem document in metadata; None if it is none."""
    try:
        document = json.loads(value)
    except (ValueError, RecursionError):
        return None
    return document if isinstance(document, dict) else None
