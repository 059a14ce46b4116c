"""A session's events, their decoding from `text/event-stream`, and how far a listener has come."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

from pretouch.client.retries import Attempts
from pretouch.errors import Internal, PretouchError, Unavailable

QUIET: Final = 45.0
"""s without a byte on an event stream after which the client checks that the service still answers."""
_LONGEST = 1024 * 1024
"""Bytes of an event."""
_OTHER_SERVICE = "Check that the address is that of a pretouch orchestrator."


@dataclass(frozen=True)
class Event:
    """Something that happened to a session.

    Attributes:
        id: increases within a session.
        type: "session", "scan", "estimate", "camera" or "end"; a newer service may know others.
        data: the event's JSON.
    """

    id: int
    type: str
    data: Any

    @staticmethod
    def parse(id: int, type: str, text: str) -> Event:
        """Decodes an event whose data is JSON text."""
        try:
            return Event(id, type, json.loads(text))
        except (ValueError, RecursionError) as error:
            raise Internal(f"The data of event {id} is not JSON.", "Use a client as new as the service.") from error


class ServerSentEvents:
    """An incremental parser of `text/event-stream`."""

    def __init__(self) -> None:
        self._rest = bytearray()
        self._size = 0
        self._fields: dict[str, list[str]] = {}

    def feed(self, chunk: bytes) -> Iterator[Event]:
        """Yields the events that `chunk` completes; raises `Internal` where it is no event stream."""
        searched = len(self._rest)
        self._rest += chunk
        start = 0
        while (end := self._rest.find(b"\n", max(start, searched))) >= 0:
            yield from self._read_line(bytes(self._rest[start:end]))
            start = end + 1
        del self._rest[:start]
        self._check_size(len(self._rest))

    def _read_line(self, line: bytes) -> Iterator[Event]:
        self._size += len(line)
        self._check_size()
        try:
            name, _, value = line.decode().removesuffix("\r").partition(":")
        except UnicodeDecodeError as error:
            raise Internal("The event stream is not UTF-8.", _OTHER_SERVICE) from error
        if name:
            self._fields.setdefault(name, []).append(value.removeprefix(" "))
        elif not line.strip():
            yield from self._flush()

    def _check_size(self, more: int = 0) -> None:
        if self._size + more > _LONGEST:
            raise Internal(f"An event has more than {_LONGEST} bytes.", _OTHER_SERVICE)

    def _flush(self) -> Iterator[Event]:
        fields, self._fields, self._size = self._fields, {}, 0
        id, type = (fields.get(name, [default])[-1] for name, default in (("id", ""), ("event", "message")))
        if "data" in fields and id.isascii() and id.isdigit() and len(id) < 19:
            yield Event.parse(int(id), type, "\n".join(fields["data"]))


class StreamProgress:
    """How far a listener has come: where to resume, and whether the session has ended.

    Attributes:
        after: id of the last event received.
        ended: whether that was the session's last event.
    """

    def __init__(self, after: int, timeout: float) -> None:
        self.after = after
        self.ended = False
        self._timeout = timeout
        self._attempts = Attempts(timeout)

    def record(self, event: Event) -> bool:
        """Notes an event; False if it was received before."""
        if event.id <= self.after:
            return False
        self.after = event.id
        self.ended = event.type == "end"
        self.start_anew()
        return True

    def start_anew(self) -> None:
        """After a sign of life, reconnecting may take the whole timeout again."""
        self._attempts = Attempts(self._timeout)

    def delay_after(self, error: PretouchError, reached: bool) -> float:
        """s to wait before reconnecting; raises `error` after too many failed attempts."""
        return self._attempts.delay_after(error, reached)


def stream_broken() -> Unavailable:
    """The error of a stream that closed before the session's last event."""
    return Unavailable("The event stream broke off.", "Listen again from the last event's id.", retry_after=0.0)
