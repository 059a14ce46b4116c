"""What the gateway sends to a device that answers: pings, to learn its clock, and identify requests."""

from __future__ import annotations

import random

from pretouch_sensor_gateway.wire_formats.binary import INTERRUPT, encode
from pretouch_sensor_gateway.wire_formats.messages import COUNTER_MODULUS, Identify, Message, Ping
from pretouch_sensor_gateway.wire_formats.parser import Identity

PING_INTERVAL = 1.0
FIRST_PING_INTERVAL = 0.05
FIRST_PINGS = 8
"""After a start this many pings go out at the shorter interval, s, so that the clock is known quickly."""
PING_LIFETIME = 2.0
"""Seconds after which a ping's reply is no longer waited for."""


class Handshake:
    """Decides when to send what. Times are host seconds of a clock that never steps.

    Args:
        number: of the ping before the first; None: drawn at random, so that replies to an earlier gateway match none.

    Attributes:
        next_send: when `take_due` has something to send; infinite before `start`.
        identity: what the device reported of itself since the last `start`; None if nothing.
    """

    def __init__(self, number: int | None = None) -> None:
        self.next_send = float("inf")
        self.identity: Identity | None = None
        self._sent: dict[int, float] = {}
        self._number = random.getrandbits(32) if number is None else number
        self._quick = 0

    def start(self, at: float) -> None:
        """Starts over: the port was opened or the device restarted, so replies to earlier pings are void."""
        self._sent.clear()
        self.identity = None
        self._quick = FIRST_PINGS
        self.next_send = at

    def take_due(self, at: float) -> list[Message]:
        """The messages to send now; none before `next_send`."""
        if at < self.next_send:
            return []
        self._sent = {number: sent for number, sent in self._sent.items() if at - sent < PING_LIFETIME}
        self._number = _next_number(self._number)
        self._sent[self._number] = at
        requests: list[Message] = [Identify()] if self.identity is None else []
        self._quick = max(0, self._quick - 1)
        self.next_send = at + (FIRST_PING_INTERVAL if self._quick else PING_INTERVAL)
        return [*requests, Ping(self._number)]

    def pop_sent(self, number: int) -> float | None:
        """When the ping of that sequence number was sent, the first time it is asked; None if no reply is awaited."""
        return self._sent.pop(number, None)


def _next_number(number: int) -> int:
    """The sequence number of the ping after the one of `number`: its frame does not hold `INTERRUPT`."""
    number = (number + 1) % COUNTER_MODULUS
    while INTERRUPT in encode(Ping(number)):
        number = random.getrandbits(32)
    return number
