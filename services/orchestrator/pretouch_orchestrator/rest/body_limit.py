"""Refuses bodies that are too large, or framed in two ways, so that the client receives the answer."""

from __future__ import annotations

import asyncio
from contextlib import suppress

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from pretouch.errors import Malformed, TooLarge
from pretouch_orchestrator.rest.problems import build_problem_response

MAX_HEAD = 16 * 1024
"""Bytes of a request's path and headers."""
MAX_BODY = 16 * 1024 * 1024
"""Bytes of a request's body."""
_LINGER_BYTES, _LINGER_SECONDS = 2 * MAX_BODY, 2.0
"""How much of a refused body is read and dropped before the connection is closed: a client whose connection closes
while it still writes may lose the answer."""


class BodyLimit:
    """Passes bodies of up to MAX_BODY bytes to `app`, and answers larger ones with 413, announced or not."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = dict(scope["headers"])
        if (error := _find_framing_error(scope)) is not None:
            await build_problem_response(error, {"Connection": "close"})(scope, receive, send)
            return
        length = headers.get(b"content-length", b"0")
        too_large = length.isdigit() and int(length) > MAX_BODY
        chunked = b"transfer-encoding" in headers
        body = _Body(receive, too_large=too_large)
        if too_large or chunked:
            # A client that waits for "100 Continue" has sent nothing yet, and reading would request the body.
            send = _Lingering(send, body, read_on=b"expect" not in headers)
        await self._app(scope, body, send)


def _find_framing_error(scope: Scope) -> Malformed | TooLarge | None:
    """What h11 lets pass: another HTTP, a length that a proxy may believe although the body comes in chunks, and a
    large head that comes at once."""
    names = {name for name, _ in scope["headers"]}
    if not scope["http_version"].startswith("1."):
        return Malformed(f"This port speaks HTTP/1.1, not HTTP/{scope['http_version']}.", "Call gRPC at its own port.")
    if b"transfer-encoding" in names and b"content-length" in names:
        return Malformed(
            "The body has both a length and chunks.", "Send Content-Length or Transfer-Encoding, not both."
        )
    if sum(len(name) + len(value) for name, value in scope["headers"]) + len(scope["raw_path"]) > MAX_HEAD:
        return TooLarge("The request's head is too large.", f"Send headers of at most {MAX_HEAD} bytes.")
    return None


class _Body:
    """Receives a body of up to MAX_BODY bytes; nothing of one that is announced as larger."""

    def __init__(self, receive: Receive, *, too_large: bool) -> None:
        self._receive = receive
        self._left = -1 if too_large else MAX_BODY
        self.complete = False

    async def __call__(self) -> Message:
        if self._left >= 0:
            message = await self._next()
        if self._left < 0:
            raise TooLarge(f"The body is larger than {MAX_BODY} bytes.", "Crop the image, or thin out the scan.")
        return message

    async def drop(self) -> None:
        """Reads and drops more of the body for a limited time."""
        self._left = _LINGER_BYTES
        with suppress(TimeoutError):
            async with asyncio.timeout(_LINGER_SECONDS):
                while not self.complete and self._left > 0:
                    await self._next()

    async def _next(self) -> Message:
        message = await self._receive()
        self._left -= len(message.get("body", b""))
        self.complete = not message.get("more_body", False)
        return message


class _Lingering:
    """Sends an answer. An error before the body's end closes the connection, after dropping some of the body."""

    def __init__(self, send: Send, body: _Body, *, read_on: bool) -> None:
        self._send = send
        self._body = body
        self._read_on = read_on
        self._closing = False

    async def __call__(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            self._closing = message["status"] >= 400 and not self._body.complete
            if self._closing:
                message = {**message, "headers": [*message["headers"], (b"connection", b"close")]}
        elif self._closing and self._read_on and not message.get("more_body", False):
            await self._send({**message, "more_body": True})
            await self._body.drop()
            message = {"type": "http.response.body"}
        await self._send(message)
