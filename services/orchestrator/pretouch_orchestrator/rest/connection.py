"""One HTTP/1.1 connection: its peer must send and read fast enough, and bad framing is answered as a problem."""

from __future__ import annotations

import socket
import struct
import sys
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

from pretouch.errors import Malformed, TooLarge
from pretouch_orchestrator.rest.body_limit import MAX_HEAD
from pretouch_orchestrator.rest.problems import build_problem_response

PATIENCE = 20.0
"""s: how long the head of a request may take, or nothing be asked on a connection that is kept open."""
LEAST_BYTES = 320 * 1024
"""What a peer must send of a body, or read of an answer, in every PATIENCE seconds that we wait for it."""
SLOW_BODY = "pretouch.slow_body"
"""Key of a request's scope, true where its body comes as a robot moves: a byte in every PATIENCE seconds is enough."""
_LINGER = (
    1.0  # s that we go on reading after a refusal: a client whose connection closes while it writes may lose the answer
)
_LOW_WATER_STEP = 48 * 1024  # bytes that have left at least when a transport asks for more, by asyncio's defaults


class BoundedConnection(H11Protocol):
    """uvicorn's connection, closed where its peer keeps it waiting. `check` is to be called every second or so."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.idle_since = self.loop.time()
        self._waits_for = ""
        self._waits_since = 0.0
        self._moved = 0
        self._unread = 0
        self._refused = False

    @property
    def idle(self) -> bool:
        """Whether no request is being served: it may be closed in favour of another."""
        return self.cycle is None or self.cycle.response_complete

    def reset(self) -> None:
        """Closes the connection at once; what the peer has not read is dropped, in the kernel too."""
        self.transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self.transport.abort()

    def check(self, now: float) -> None:
        """Ends the connection if we have waited too long for its peer; `now` is the loop's time, s."""
        unread = self.transport.get_write_buffer_size()
        self._moved += max(0, self._unread - unread)
        self._unread = unread
        waits_for = self._find_wait()
        if waits_for != self._waits_for:
            self._wait(waits_for, now)
        elif waits_for and now - self._waits_since > PATIENCE:
            if self._moved < (1 if waits_for == "poses" else LEAST_BYTES) or waits_for == "head":
                self._end(waits_for)
            else:
                self._wait(waits_for, now)

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        self._wait("head", self.idle_since)

    def data_received(self, data: bytes) -> None:
        self._moved += len(data)
        if not self._refused:
            super().data_received(data)

    def resume_writing(self) -> None:
        self._moved += _LOW_WATER_STEP
        super().resume_writing()

    def on_response_complete(self) -> None:
        self.idle_since = self.loop.time()
        self._wait("head", self.idle_since)
        if self.conn.trailing_data[
            0
        ]:  # requests that did not wait for this answer would be served before others' first
            self.transport.close()
        super().on_response_complete()

    def send_400_response(self, msg: str) -> None:
        """Answers what is no HTTP; uvicorn calls it while it handles h11's error."""
        self._refuse(_explain(sys.exception()))

    def _should_upgrade(self) -> bool:
        """Nothing is upgraded, and uvicorn would log each wish."""
        return False

    def _wait(self, what: str, now: float) -> None:
        self._waits_for, self._waits_since, self._moved = what, now, 0

    def _find_wait(self) -> str:
        """What the peer should do next; "" if it is our turn."""
        if self._unread or self.transport.is_closing() or self._refused:
            return "reading"
        if self.conn.their_state is h11.SEND_BODY:
            if self.flow.read_paused:
                return ""
            return "poses" if self.cycle is not None and self.cycle.scope.get(SLOW_BODY) else "body"
        return "head" if self.idle else ""

    def _end(self, waited_for: str) -> None:
        if waited_for == "reading":
            self.reset()
        elif (self.cycle is not None and self.idle) or (waited_for == "head" and not self.conn.trailing_data[0]):
            self.transport.close()
        else:
            self._refuse(
                Malformed(
                    f"The request's {waited_for} did not come in time.",
                    f"Send the head within {PATIENCE:g} s, and bodies with {LEAST_BYTES / PATIENCE / 1024:g} KiB/s.",
                )
            )

    def _refuse(self, error: Malformed | TooLarge) -> None:
        """Answers `error`, if nothing has been answered yet, and closes."""
        if self.conn.our_state in (h11.IDLE, h11.SEND_RESPONSE):
            response = build_problem_response(error)
            self.transport.write(
                self.conn.send(
                    h11.Response(
                        status_code=response.status_code,
                        headers=[*response.raw_headers, (b"connection", b"close")],
                    )
                )
                + self.conn.send(h11.Data(data=bytes(response.body)))
                + self.conn.send(h11.EndOfMessage())
            )
        if self.cycle is not None and not self.cycle.response_complete:  # the application must not answer it as well
            self.cycle.disconnected = True
            self.cycle.message_event.set()
        if self.transport.can_write_eof():  # not over TLS
            self.transport.write_eof()
        self._refused = True
        self.loop.call_later(_LINGER, self.transport.close)


def _explain(error: BaseException | None) -> Malformed | TooLarge:
    if isinstance(error, h11.RemoteProtocolError) and error.error_status_hint == 431:
        return TooLarge("The request's head is too large.", f"Send headers of at most {MAX_HEAD} bytes.")
    return Malformed(f"The request is no HTTP/1.1: {error!s:.200}.", "Let an HTTP library write the request.")
