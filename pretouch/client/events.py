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


@dataclass(frozen=True)
class Event:
    """Something that happened to a session.

    Attributes:
        id: increases within a session.
        type: "session", "scan", "estimate" or "end"; a newer service may know others.
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
        except ValueError as error:
            raise Internal(f"The data of event {id} is not JSON.", "Use a client as new as the service.") from error


class ServerSentEvents:
    """An incremental parser of `text/event-stream`."""

    def __init__(self) -> None:
        self._rest = b""
        self._fields: dict[str, str] = {}

    def feed(self, chunk: bytes) -> Iterator[Event]:
        """Yields the events that `chunk` completes."""
        *lines, self._rest = (self._rest + chunk).split(b"\n")
        for line in lines:
            name, _, value = line.decode().removesuffix("\r").partition(":")
            if name:
                value = value.removeprefix(" ")
                known = self._fields.get(name)
                self._fields[name] = f"{known}\n{value}" if known is not None and name == "data" else value
            elif not line.strip():
                yield from self._flush()

    def _flush(self) -> Iterator[Event]:
        fields, self._fields = self._fields, {}
        if "data" in fields and fields.get("id", "").isdigit():
            yield Event.parse(int(fields["id"]), fields.get("event", "message"), fields["data"])


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

    def record(self, event: Event) -> None:
        self.after = event.id
        self.ended = event.type == "end"
        self._attempts = Attempts(self._timeout)

    def delay_after(self, error: PretouchError) -> float:
        """s to wait before reconnecting; raises `error` after too many failed attempts."""
        return self._attempts.delay_after(error)


def stream_broken() -> Unavailable:
    """The error of a stream that closed before the session's last event."""
    return Unavailable("The event stream broke off.", "Listen again from the last event's id.")
