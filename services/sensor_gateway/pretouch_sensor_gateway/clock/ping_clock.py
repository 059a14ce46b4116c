"""Maps a device's clock to the host's, by pings.

A ping is sent at host time a, answered at device time d, its answer read at host time b: d is somewhere within [a, b],
so the midpoint is off by at most half the round trip b - a (Cristian, 1989). The midpoint of the
quickest ping is off by half the difference between its two ways, which is unknown: it remains as a standard deviation
of round trip / sqrt(12). The additional error of a slower ping is at most half of its additional delay, so slower pings
get less weight (as in NTP's clock filter, Mills, 2006). How that delay is distributed between the two ways is estimated
along with the clock: a USB latency timer, for example, delays only the replies.

Host times are seconds of a clock that never steps (`time.monotonic`).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import sqrt

import numpy as np

from pretouch_sensor_gateway.clock.clock_fit import MEMORY, ClockFit, fit_clock
from pretouch_sensor_gateway.clock.thinning_buffer import ThinningBuffer

CONTRADICTION = 5.0
"""Standard deviations beyond its round trip at which a reply contradicts the clock estimate."""
AGREEING = 3
"""Contradicting replies in a row that replace the estimate, if they agree with each other."""
_RESOLUTION = 4e-6
"""Seconds of one tick of a microsecond clock, while it is not known: an Arduino's counts by fours."""
_COARSEST, _TELLING = 1e-3, 6
"""Seconds of the coarsest tick, and the number of pings from which on the greatest common divisor of the times between
them is one tick or several, rather than chance."""
_MAX_DRIFT = 0.1
"""s/s; no oscillator is worse."""


@dataclass(frozen=True)
class HostTime:
    """A moment, s of `time.monotonic`, and one standard deviation of it, s."""

    at: float
    std: float


@dataclass(frozen=True)
class _Ping:
    """One exchange: host time sent and received, device time between these, s."""

    sent: float
    received: float
    device: float

    @property
    def round_trip(self) -> float:
        return self.received - self.sent

    def agrees(self, other: _Ping) -> bool:
        """Whether one clock can have answered both."""
        apart = abs((self.sent + self.received - other.sent - other.received) / 2 - (self.device - other.device))
        return apart <= (self.round_trip + other.round_trip) / 2 + _MAX_DRIFT * abs(self.device - other.device)


class PingClock:
    """The clock of one boot session, from the replies to pings.

    Attributes:
        contradictions: replies that contradicted the estimate. Each is ignored, unless several in a row agree with
            each other: then the estimate starts over with these.
    """

    def __init__(self) -> None:
        self.contradictions = 0
        self._pings: ThinningBuffer[_Ping] = ThinningBuffer(lambda ping: ping.round_trip)
        self._contradicting: deque[_Ping] = deque(maxlen=AGREEING)
        self._fit: ClockFit | None = None
        self._least = 0.0
        self._resolution = _RESOLUTION

    @property
    def synchronised(self) -> bool:
        """Whether a ping was answered since the device's boot."""
        return self._fit is not None

    @property
    def drift(self) -> float:
        """Seconds a second by which the device's clock runs fast; 0 while unknown."""
        return 0.0 if self._fit is None else -self._fit.slope / (1 + self._fit.slope)

    @property
    def round_trip(self) -> float:
        """The shortest round trip of the recent pings, s; 0 if there are none."""
        return self._least

    def restart(self) -> None:
        """Forgets the estimate: the device restarted."""
        self._pings.clear()
        self._contradicting.clear()
        self._fit = None
        self._least = 0.0
        self._resolution = _RESOLUTION

    def add_ping(self, sent: float, received: float, device: float) -> None:
        """Learns from a ping: sent, and its reply read, at host times, s; answered at an unwrapped device time, s."""
        ping = _Ping(sent, received, device)
        if self._contradicts(ping):
            self.contradictions += 1
            self._contradicting.append(ping)
            if len(self._contradicting) < AGREEING or not all(map(ping.agrees, self._contradicting)):
                return
            self._pings.clear()
            for earlier in self._contradicting:
                self._pings.append(earlier)
        else:
            self._pings.append(ping)
        self._contradicting.clear()
        self._fit_clock()

    def host_time(self, device: float) -> HostTime | None:
        """Host time of an unwrapped device time, s; None before the first answered ping."""
        if self._fit is None:
            return None
        at, variance = self._fit.at(device)
        return HostTime(at, sqrt(variance + (self._least * self._least + self._resolution * self._resolution) / 12))

    def _contradicts(self, ping: _Ping) -> bool:
        expected = self.host_time(ping.device)
        if expected is None:
            return False
        beyond = max(ping.sent - expected.at, expected.at - ping.received)
        return beyond > CONTRADICTION * expected.std

    def _fit_clock(self) -> None:
        pings = np.array([(ping.sent, ping.received, ping.device) for ping in self._pings])
        sent, received, device = pings[pings[:, 2] > pings[-1, 2] - MEMORY].T
        round_trip = received - sent
        self._least = float(round_trip.min())
        excess = round_trip - self._least
        if len(device) >= _TELLING:
            tick = int(np.gcd.reduce(np.rint((device - device[0]) * 1e6).astype(np.int64)))
            self._resolution = min(tick * 1e-6, _COARSEST) or _RESOLUTION
        floor = float(np.median(excess)) / 2  # the quickest ping is not the quickest possible
        noise = (excess**2 + floor**2 + self._resolution**2) / 12
        self._fit = fit_clock(device, (sent + received) / 2, noise, excess / 2)
