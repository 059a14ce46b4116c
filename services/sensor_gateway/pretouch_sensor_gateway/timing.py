"""When a device's measurements were, by whichever clock it gives: answers to pings, times on its lines, or none."""

from __future__ import annotations

from pretouch_sensor_gateway.assembler import Timed
from pretouch_sensor_gateway.clock.arrival_clock import ArrivalClock
from pretouch_sensor_gateway.clock.ping_clock import HostTime, PingClock
from pretouch_sensor_gateway.clock.wall_clock import WallClock
from pretouch_sensor_gateway.source import ClockState
from pretouch_sensor_gateway.succession import Successor


class Timing:
    """The clocks of one device and of the host. Host times are seconds of `time.monotonic`."""

    def __init__(self) -> None:
        self._pings = PingClock()
        self._arrivals = ArrivalClock()
        self._wall = WallClock()
        self._std = float("nan")

    @property
    def answers(self) -> bool:
        """Whether the device has answered a ping since its start."""
        return self._pings.synchronised

    def restart(self) -> None:
        """The device started anew."""
        self._pings.restart()
        self._arrivals.restart()

    def observe(self, at: float, unix: float) -> None:
        """Host time `at`, s, was `unix` s since the Unix epoch."""
        self._wall.observe(at, unix)

    def answered(self, sent: float, received: float, device: float) -> None:
        """A ping sent at `sent` was answered when the device's clock, s, stood at `device`; the answer was read."""
        self._pings.answered(sent, received, device)

    def timed(self, successor: Successor, two_way: bool) -> Timed:
        """When a measurement was made; of a device that is to answer pings, once it `answers`."""
        arrival = successor.arrival
        host: HostTime | None
        if two_way:
            assert successor.device is not None
            host = self._pings.host_time(successor.device)
            assert host is not None
        else:
            host = self._arrivals.host_time(arrival.at, arrival.transmission, successor.device)
        self._std = host.std
        return Timed(arrival.message, successor.sequence, self._wall.unix(host.at), host.std)

    def state(self, synchronised: bool) -> ClockState:
        """How the clocks compare, for people."""
        return ClockState(synchronised, self._pings.drift, self._std, self._pings.round_trip, self._wall.jumps)
