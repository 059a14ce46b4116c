"""The recent events, with repeated ones counted in one line."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

KEPT = 100
QUIET = 10.0
"""Seconds after which a repeated event counts as a new one."""


class Severity(Enum):
    """How serious an event is."""

    GOOD = "good"
    NOTE = "note"
    BAD = "bad"


@dataclass(frozen=True)
class Event:
    """Something that happened, once or repeatedly.

    Attributes:
        device: of the event; "" is the gateway.
        first, at: when it first and last happened, s.
        amount: the total of what is counted, as frames lost.
        times: how often it happened.
    """

    device: str
    text: str
    severity: Severity
    first: float
    at: float
    amount: int = 1
    times: int = 1


class EventLog:
    """The last events, in the order in which they last happened."""

    def __init__(self) -> None:
        self._events: OrderedDict[int, Event] = OrderedDict()
        self._counted: dict[tuple[str, str], int] = {}
        self._next = 0

    def add(self, device: str, text: str, severity: Severity, at: float) -> None:
        """Adds a single event."""
        self._put(self._next_key(), Event(device, text, severity, at, at))

    def count(self, device: str, what: str, amount: int, at: float, describe: Callable[[int, int], str]) -> None:
        """Adds `amount` to the last event of this kind, `what`, or starts a new one if that was long ago.

        Args:
            describe: makes the text from the amount and the number of times.
        """
        key = self._counted.get((device, what), -1)
        before = self._events.get(key)
        if before is None or at - before.at > QUIET:
            key = self._counted[device, what] = self._next_key()
            self._put(key, Event(device, describe(amount, 1), Severity.BAD, at, at, amount))
            return
        total, times = before.amount + amount, before.times + 1
        self._put(key, Event(device, describe(total, times), Severity.BAD, before.first, at, total, times))

    def last(self, count: int) -> list[Event]:
        """The last `count` events, oldest first."""
        return list(self._events.values())[-count:] if count > 0 else []

    def _next_key(self) -> int:
        self._next += 1
        return self._next

    def _put(self, key: int, event: Event) -> None:
        self._events[key] = event
        self._events.move_to_end(key)
        while len(self._events) > KEPT:
            self._events.popitem(last=False)
