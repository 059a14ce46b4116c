"""Requests to open a session, as raw multipart forms and raw messages, valid except for what a test changes."""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np
from google.protobuf.message import Message

from helpers.box_session import DEPTH, MASK, request
from helpers.box_view import png
from pretouch.geometry import Plane, Pose
from pretouch.prior import Prior
from pretouch.v1 import orchestrator_pb2 as pb
from pretouch.wire.common import array_to_proto
from pretouch.wire.json import request_to_json
from pretouch.wire.session import request_to_proto

FULL = request(
    roi=(0, 0, 320, 240),
    table=Plane(np.array([0.0, 0.0, 1.0]), 0.0),
    base_T_object=Pose.identity(),
    prior=Prior(),
)
"""A request with every member."""


def files(document: Any = None, depth: bytes | None = None, mask: bytes | None = None) -> dict[str, Any]:
    """The multipart form, good but for what is given."""
    body = json.dumps(request_to_json(request()) if document is None else document).encode()
    return {
        "request": ("request.json", body, "application/json"),
        "depth": ("depth.png", png(DEPTH) if depth is None else depth, "application/octet-stream"),
        "mask": ("mask.png", png(np.where(MASK, 255, 0).astype(np.uint8)) if mask is None else mask, "image/png"),
    }


def message(depth: np.ndarray = DEPTH, mask: np.ndarray = MASK) -> pb.CreateSessionRequest:
    return request_to_proto(request(), depth, mask)


def changed(path: str, value: Any) -> Any:
    """The request's JSON with the member at the dotted `path` set to `value`."""
    result = request_to_json(FULL)
    *parents, last = [int(step) if step.isdigit() else step for step in path.split(".")]
    owner: Any = result
    for step in parents:
        owner = owner[step]
    owner[last] = value
    return result


def set_field(path: str, value: Any) -> pb.CreateSessionRequest:
    """The request's message with the field at the dotted `path` set to `value`."""
    result: Message = request_to_proto(FULL, DEPTH, MASK)
    *parents, last = path.split(".")
    owner: Any = result
    for step in parents:
        owner = owner[int(step)] if step.isdigit() else getattr(owner, step)
    if last.isdigit():
        owner[int(last)] = value
    else:
        setattr(owner, last, value)
    return result  # type: ignore[return-value]


def image(shape: tuple[int, int], value: int, dtype: type = np.uint8) -> np.ndarray:
    return np.full(shape, value, dtype)


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=True)
    return stream.getvalue()


def with_roi(u0: int, v0: int, u1: int, v1: int) -> pb.CreateSessionRequest:
    result = message()
    result.roi.CopyFrom(pb.Roi(u0=u0, v0=v0, u1=u1, v1=v1))
    return result


def without(name: str) -> pb.CreateSessionRequest:
    result = message()
    result.ClearField(name)  # type: ignore[arg-type]
    return result


def with_depth(array: np.ndarray, dtype: str) -> pb.CreateSessionRequest:
    result = message()
    result.depth.CopyFrom(array_to_proto(array, dtype))
    return result
