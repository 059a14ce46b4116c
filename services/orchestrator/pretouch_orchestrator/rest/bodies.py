"""Reads request bodies: multipart forms, and strict JSON."""

from __future__ import annotations

import json
from typing import Any, NoReturn

from fastapi import Request
from starlette.datastructures import FormData, Headers
from starlette.formparsers import MultiPartException, MultiPartParser
from starlette.requests import ClientDisconnect

from pretouch.errors import InvalidInput, Malformed, UnsupportedMedia
from pretouch_orchestrator.rest.body_limit import MAX_BODY

PARTS: dict[str, tuple[str, ...]] = {
    "request": ("application/json", "text/plain", "application/octet-stream"),
    "depth": ("image/png", "application/octet-stream", "application/x-npy"),
    "mask": ("image/png", "application/octet-stream"),
}
"""The parts of a session's creation and the media types that each may declare; as with curl, it may declare none."""


def parse_json(data: bytes, name: str) -> Any:
    """Parses a JSON document.

    Raises:
        Malformed: not JSON in UTF-8, nested too deeply, or with NaN, Infinity, a number out of a double's range or a
            lone surrogate, none of which is JSON.
    """
    try:
        text = data.decode("utf-8")
        document = json.loads(text, parse_constant=_refuse_constant)
        if "\\ud" in text.lower():
            json.dumps(document, ensure_ascii=False).encode("utf-8")
    except (ValueError, RecursionError) as error:
        if isinstance(error, json.JSONDecodeError):
            reason = f"{error.msg} at line {error.lineno}, column {error.colno}"
        else:
            reason = "nested too deeply" if isinstance(error, RecursionError) else str(error)[:200]
        raise Malformed(f"{name} is not JSON: {reason}.", "Send a JSON document in UTF-8.") from error
    return document


def _refuse_constant(constant: str) -> NoReturn:
    raise ValueError(f"it holds {constant}, which JSON does not have")


async def read_json(request: Request) -> bytes:
    """The body of a request whose content type must be JSON.

    Raises:
        UnsupportedMedia: another content type, or none.
    """
    media_type = _parse_media_type(request.headers.get("content-type", ""))
    if media_type != "application/json":
        raise UnsupportedMedia(
            f"The body's type is {media_type or 'not given'!r}.", "Send it as `Content-Type: application/json`."
        )
    try:
        return await request.body()
    except ClientDisconnect as error:
        raise _build_cut_off_error() from error


async def read_parts(request: Request) -> dict[str, bytes]:
    """The parts of a multipart form by name: `request` and `depth`, and `mask` if it came.

    Raises:
        UnsupportedMedia: no multipart form, or a part with a media type that is not accepted.
        Malformed: a form that cannot be parsed.
        InvalidInput: a part that is missing, unknown or repeated.
    """
    content_type = request.headers.get("content-type", "")
    if _parse_media_type(content_type) != "multipart/form-data":
        raise UnsupportedMedia(
            f"The body's type is {_parse_media_type(content_type) or 'not given'!r}.",
            "Send `multipart/form-data` with the parts request, depth and, if you have one, mask.",
        )
    parts: dict[str, bytes] = {}
    for name, value, declared in await _read_items(request, content_type):
        if name not in PARTS:
            raise InvalidInput(f"The part {name!r:.80} is not known.", f"Send only {', '.join(PARTS)}.")
        if name in parts:
            raise InvalidInput(f"The part {name!r} occurs twice.", "Send each part once.")
        if declared and _parse_media_type(declared) not in PARTS[name]:
            raise UnsupportedMedia(
                f"The part {name!r} is declared as {declared!r:.80}.", f"Send it as {' or '.join(PARTS[name])}."
            )
        parts[name] = value
    for name in ("request", "depth"):
        if name not in parts:
            raise InvalidInput(f"The part {name!r} is missing.", f"Send the part {name!r}.")
    return parts


async def _read_items(request: Request, content_type: str) -> list[tuple[str, bytes, str]]:
    """Name, bytes and declared media type of each part."""
    form = await _parse_form(request, content_type)
    try:
        return [
            (name, value.encode("latin-1"), "")
            if isinstance(value, str)
            else (name, await value.read(), value.content_type or "")
            for name, value in form.multi_items()
        ]
    finally:
        await form.close()


class _InMemory(MultiPartParser):
    """Writes no part to a disk that may be full: bodies are small, and counted (`BodyLimit`)."""

    spool_max_size = MAX_BODY


async def _parse_form(request: Request, content_type: str) -> FormData:
    # Latin-1 maps bytes to characters one to one, so that the bytes of a part without a file name can be recovered.
    headers = Headers({"content-type": f"{_strip_charset(content_type)}; charset=latin-1"})
    parser = _InMemory(headers, request.stream(), max_files=8, max_fields=8, max_part_size=MAX_BODY)
    try:
        return await parser.parse()
    except MultiPartException as error:
        raise Malformed(
            f"The multipart form cannot be read: {error.message}", "Let an HTTP library write the form."
        ) from error
    except ClientDisconnect as error:
        raise _build_cut_off_error() from error


def _build_cut_off_error() -> Malformed:
    return Malformed("The body was cut off.", "Send it again.")


def _strip_charset(content_type: str) -> str:
    kept = [part for part in content_type.split(";") if not part.strip().lower().startswith("charset=")]
    return ";".join(kept)


def _parse_media_type(content_type: str) -> str:
    return content_type.partition(";")[0].strip().lower()
