"""The recent events, with repeated ones counted in one line."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

KEPT = 100
QUIET = 10.0
"""Seconds after which what is counted begins a new event."""


class Severity(Enum):
    """How serious an event is: the style in which it is shown."""

    GOOD = "green"
    NOTE = ""
    BAD = "yellow"


@dataclass(frozen=True)
class Event:
    """Something that happened, or was counted.

    Attributes:
        device: of the event; "" is the gateway.
        first, at: when it first and last happened, s.
        amount: the total of what is counted; 0: nothing is.
    """

    device: str
    text: str
    severity: Severity
    first: float
    at: float
    amount: int = 0


class EventLog:
    """The last events, in the order in which they last happened."""

    def __init__(self) -> None:
        self._events: list[Event] = []

    def add(self, device: str, text: str, severity: Severity, at: float, amount: int = 0) -> None:
        """Adds an event; `amount` is added to that of the same device and text, unless that was long ago."""
        first = at
        for event in self._events:
            if amount and (event.device, event.text) == (device, text) and at - event.at <= QUIET:
                self._events.remove(event)
                first, amount = event.first, amount + event.amount
                break
        self._events.append(Event(device, text, severity, first, at, amount))
        del self._events[:-KEPT]

    def last(self, count: int) -> list[Event]:
        """The last `count` events, oldest first."""
        return self._events[-count:]
