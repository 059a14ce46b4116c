"""What the gateway says to a device that listens: who are you, and what time is it."""

from __future__ import annotations

import random

from pretouch_sensor_gateway.wire_formats.messages import COUNTER_MODULUS, Identify, Message, Ping
from pretouch_sensor_gateway.wire_formats.received import Identity

PING_INTERVAL = 1.0
FIRST_PING_INTERVAL = 0.05
FIRST_PINGS = 8
"""After a start the clock is sought quickly: this many pings at the shorter interval, s."""
PING_LIFETIME = 2.0
"""Seconds after which a ping's reply is no longer waited for."""


class Handshake:
    """Decides when to send what. Times are host seconds of a clock that never steps.

    Attributes:
        next: when `due` has something to send; infinite before `begin`.
        identity: what the device said of itself since the last `begin`, None if nothing.
    """

    def __init__(self) -> None:
        self.next = float("inf")
        self.identity: Identity | None = None
        self._sent: dict[int, float] = {}
        self._number = random.getrandbits(32)
        self._quick = 0

    def begin(self, at: float) -> None:
        """The line was opened, or the device started anew: all that was asked before is void."""
        self._sent.clear()
        self.identity = None
        self._quick = FIRST_PINGS
        self.next = at

    def due(self, at: float) -> list[Message]:
        """What to send now; nothing before `next`."""
        if at < self.next:
            return []
        self._sent = {number: sent for number, sent in self._sent.items() if at - sent < PING_LIFETIME}
        self._number = (self._number + 1) % COUNTER_MODULUS
        self._sent[self._number] = at
        asks: list[Message] = [Identify()] if self.identity is None else []
        self._quick = max(0, self._quick - 1)
        self.next = at + (FIRST_PING_INTERVAL if self._quick else PING_INTERVAL)
        return [*asks, Ping(self._number)]

    def sent(self, number: int) -> float | None:
        """When the ping of that sequence number went out; None if no answer to it is awaited. Asked once."""
        return self._sent.pop(number, None)
