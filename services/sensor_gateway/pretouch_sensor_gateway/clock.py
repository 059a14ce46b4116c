"""From a device's clock to the host's.

A device counts microseconds in 32 bits from its start, so its count wraps every 71.6 minutes and its crystal is tens of
parts per million off. A ping is sent at host time a, answered at device time d, its answer read at host time b: d is
somewhere within [a, b], so the midpoint is off by at most half the round trip (Cristian, 1989). Of the recent pings the
one with the least bound on its error counts: half its round trip, plus what the crystal may have drifted since.

Host times are seconds of a clock that never steps (`time.monotonic`).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from pretouch_sensor_gateway.messages import COUNTER_MODULUS

MAX_DRIFT = 1e-4
"""Seconds a second that a device's clock may run fast or slow: a crystal has 20-50 ppm; twice that."""
WINDOW = 32
"""Pings remembered."""
MAX_JUMP = 5.0
"""Seconds that a message's device time may differ from what the last one and the host's clock foretell. More is a
device that started anew; less is a host that was busy. Mistaking a long pause for a new start costs one ping."""


def signed_difference(new: int, old: int) -> int:
    """`new` - `old` of two counters that wrap at 2^32, in [-2^31, 2^31)."""
    half = COUNTER_MODULUS // 2
    return (new - old + half) % COUNTER_MODULUS - half


@dataclass(frozen=True)
class _Exchange:
    """One ping: device time (unwrapped, s) and host midpoint (s) of the same moment, and how long it took (s)."""

    device: float
    host: float
    round_trip: float


class DeviceClock:
    """The clock of one device, through its restarts.

    Attributes:
        epoch: how many times the device has started anew since the gateway first heard it.
    """

    def __init__(self) -> None:
        self.epoch = 0
        self._last: tuple[int, float] | None = None
        self._exchanges: deque[_Exchange] = deque(maxlen=WINDOW)
        self._best: _Exchange | None = None

    @property
    def synchronised(self) -> bool:
        """Whether a ping was answered since the device's start."""
        return self._best is not None

    def follows(self, micros: int, arrival: float) -> bool:
        """Whether device time `micros` in a message that came at host time `arrival`, s, can follow the last one."""
        if self._last is None:
            return True
        ticks, _ = self._last
        return abs(self._unwrapped(micros, arrival) - self._foretold(arrival, ticks)) <= MAX_JUMP * 1e6

    def restart(self) -> None:
        """Begins a new epoch: the device started anew, and what was known of its clock is void."""
        self.epoch += 1
        self._last = self._best = None
        self._exchanges.clear()

    def unwrap(self, micros: int, arrival: float) -> float:
        """Device time, s, without wraps, of a message's `micros`; `arrival` is when it came, host s."""
        ticks = self._unwrapped(micros, arrival)
        self._last = (ticks, arrival)
        return ticks * 1e-6

    def answered(self, sent: float, received: float, device: float) -> None:
        """Learns from a ping: sent and received at these host times, s, answered at unwrapped device time, s."""
        self._exchanges.append(_Exchange(device, (sent + received) / 2, received - sent))
        self._best = min(self._exchanges, key=lambda e: e.round_trip / 2 + MAX_DRIFT * (received - e.host))

    def host_time(self, device: float) -> float | None:
        """Host time, s, of an unwrapped device time, s; None before the first answered ping."""
        if self._best is None:
            return None
        return self._best.host + (device - self._best.device)

    def _foretold(self, arrival: float, ticks: int) -> int:
        assert self._last is not None
        return ticks + round((arrival - self._last[1]) * 1e6)

    def _unwrapped(self, micros: int, arrival: float) -> int:
        if self._last is None:
            return micros
        foretold = self._foretold(arrival, self._last[0])
        return foretold + signed_difference(micros, foretold)
