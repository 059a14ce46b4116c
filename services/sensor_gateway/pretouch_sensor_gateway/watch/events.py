"""What happened, in few lines: things that happen again and again are counted in one."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

KEPT = 100
QUIET = 10.0
"""Seconds after which something that happened again counts as new."""


class Severity(Enum):
    """How an event is to be taken."""

    GOOD = "good"
    NOTE = "note"
    BAD = "bad"


@dataclass(frozen=True)
class Event:
    """Something that happened.

    Attributes:
        device: to whom; "" is the gateway.
        first, at: when it began and when it last happened, s.
        amount: how many of it, all together.
        times: how often it happened.
    """

    device: str
    text: str
    weight: Severity
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

    def add(self, device: str, text: str, weight: Severity, at: float) -> None:
        """Notes something that happens once."""
        self._put(self._new(), Event(device, text, weight, at, at))

    def count(self, device: str, what: str, amount: int, at: float, said: Callable[[int, int], str]) -> None:
        """Notes `amount` more of `what`, together with what there was of it before, unless that was long ago.

        Args:
            said: the text for an amount and the number of times.
        """
        key = self._counted.get((device, what), -1)
        before = self._events.get(key)
        if before is None or at - before.at > QUIET:
            key = self._counted[device, what] = self._new()
            self._put(key, Event(device, said(amount, 1), Severity.BAD, at, at, amount))
            return
        total, times = before.amount + amount, before.times + 1
        self._put(key, Event(device, said(total, times), Severity.BAD, before.first, at, total, times))

    def last(self, count: int) -> list[Event]:
        """The last `count` events, oldest first."""
        return list(self._events.values())[-count:] if count > 0 else []

    def _new(self) -> int:
        self._next += 1
        return self._next

    def _put(self, key: int, event: Event) -> None:
        self._events[key] = event
        self._events.move_to_end(key)
        while len(self._events) > KEPT:
            self._events.popitem(last=False)
