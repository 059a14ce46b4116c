"""Reads tip poses from a body of JSON lines that goes on for as long as the robot moves."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence

from fastapi import Request
from starlette.requests import ClientDisconnect

from pretouch.errors import Malformed, UnsupportedMedia
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.wire.common import pose_to_proto
from pretouch.wire.reader import Members, prefix_errors
from pretouch_orchestrator.rest.bodies import parse_json
from pretouch_orchestrator.rest.connection import SLOW_BODY

MEDIA_TYPES = ("application/x-ndjson", "application/ndjson", "application/jsonl")
MAX_LINE = 4096
"""Bytes of a line."""


def check_media_type(request: Request) -> None:
    """Raises `UnsupportedMedia` unless the body is of JSON lines."""
    media_type = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if media_type not in MEDIA_TYPES:
        raise UnsupportedMedia(
            f"The body's type is {media_type or 'not given'!r:.80}.", f"Send it as `Content-Type: {MEDIA_TYPES[0]}`."
        )


async def read_tip_poses(request: Request) -> AsyncIterator[Sequence[pb.TipPose]]:
    """The tip poses of each piece of the body as it comes; blank lines are let pass.

    Raises:
        Malformed: a line that is no JSON or too long, or a body that was cut off.
        InvalidInput: a line that is no tip pose.
        TooLarge: the body is.
    """
    request.scope[SLOW_BODY] = True
    number, rest = 0, b""
    try:
        async for chunk in request.stream():
            *lines, rest = (rest + chunk).split(b"\n")
            if len(rest) > MAX_LINE:
                raise Malformed(f"Line {number + len(lines) + 1} does not end.", "Send one tip pose on each line.")
            if lines:
                yield [_read(line, number + k) for k, line in enumerate(lines, 1) if line.strip()]
                number += len(lines)
    except ClientDisconnect as error:
        raise Malformed("The body was cut off.", "Send the poses that follow in another request.") from error
    if rest.strip():
        yield [_read(rest, number + 1)]


def _read(line: bytes, number: int) -> pb.TipPose:
    if len(line) > MAX_LINE:
        raise Malformed(f"Line {number} has more than {MAX_LINE} bytes.", "Send one tip pose on each line.")
    document = parse_json(line, f"Line {number}")
    with prefix_errors(f"Line {number}"):
        members = Members(document, "", ("t", "base_T_tip"))
        return pb.TipPose(t=members.number("t"), base_t_tip=pose_to_proto(members.pose("base_T_tip")))
