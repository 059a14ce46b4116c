"""Decodes request bodies in threads, within the service's memory: short ones do not wait behind images."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import TypeVar

import numpy as np
from fastapi import Request
from numpy.typing import NDArray

from pretouch.camera import count_pixels, decode_depth, decode_png
from pretouch.errors import InvalidInput
from pretouch.serving import ServiceContext
from pretouch.serving.memory import Reservation
from pretouch.session import SessionRequest
from pretouch.wire.json import request_from_json
from pretouch_orchestrator.rest.bodies import parse_json, read_json, read_parts
from pretouch_orchestrator.rest.body_limit import MAX_BODY

Creation = tuple[SessionRequest, NDArray[np.generic], NDArray[np.generic] | None]
T = TypeVar("T")

_PATIENCE = 5.0
"""s that a body waits for memory before it is read."""
_COPIES, _IMAGES = 2, 24 * 2**20
"""How often a body is in memory while it is read, and bytes of the largest images decoded from a small body."""
_JSON_FACTOR = 40
"""Bytes of Python objects for each byte of JSON: empty lists and objects are the worst."""
_PIXEL = 12
"""Bytes for each pixel while an image is decoded."""
_SHORT = 64 * 1024
"""Bytes of a body that takes milliseconds to decode."""


@asynccontextmanager
async def hold_creation(request: Request, context: ServiceContext) -> AsyncIterator[Creation]:
    """A session's creation as it was sent, with memory for its images for as long as the block lasts."""
    async with _hold_body(request, context, _IMAGES) as held:
        parts = await read_parts(request)
        pixels = sum(count_pixels(parts.get(name, b"")) for name in ("depth", "mask"))
        memory = _PIXEL * pixels + _JSON_FACTOR * len(parts["request"]) + len(parts["depth"])
        wanted, values, mask = await context.run_in_thread(_decode_creation, parts, memory=memory)
        parts.clear()
        held.shrink(_COPIES * (values.nbytes + (0 if mask is None else mask.nbytes)))
        yield wanted, values, mask


async def read_document(request: Request, context: ServiceContext, decode: Callable[[object], T]) -> T:
    """What `decode` makes of the request's JSON document; a short one waits for nothing."""
    if _announce(request) <= _SHORT:
        return await context.run_briefly(_decode_document, await read_json(request), decode)
    async with _hold_body(request, context, 0):
        body = await read_json(request)
        return await context.run_in_thread(_decode_document, body, decode, memory=_JSON_FACTOR * len(body))


@asynccontextmanager
async def _hold_body(request: Request, context: ServiceContext, least: int) -> AsyncIterator[Reservation]:
    budget = context.messages
    async with budget.reserve(min(max(_COPIES * _announce(request), least), budget.limit), _PATIENCE) as held:
        yield held


def _announce(request: Request) -> int:
    """Bytes that the body has, or may have if it does not say."""
    length = request.headers.get("content-length", "")
    return min(int(length), MAX_BODY) if length.isascii() and length.isdigit() else MAX_BODY


def _decode_document(body: bytes, decode: Callable[[object], T]) -> T:
    return decode(parse_json(body, "The body"))


def _decode_creation(parts: dict[str, bytes]) -> Creation:
    request = request_from_json(parse_json(parts["request"], "The part 'request'"))
    values = decode_depth(parts["depth"])
    if "mask" not in parts:
        return request, values, None
    mask = decode_png(parts["mask"], "mask")
    if mask.ndim != 2:
        raise InvalidInput("The mask has several channels.", "Send a greyscale PNG without transparency.")
    return request, values, mask
