"""Gives measurements their Unix time, from what the device offers: ping replies, times on its lines, or nothing."""

from __future__ import annotations

from typing import NamedTuple

from pretouch_sensor_gateway.clock.arrival_clock import ArrivalClock
from pretouch_sensor_gateway.clock.ping_clock import HostTime, PingClock
from pretouch_sensor_gateway.clock.wall_clock import WallClock
from pretouch_sensor_gateway.sequence_tracker import TrackedMeasurement
from pretouch_sensor_gateway.source import ClockState


class Timestamp(NamedTuple):
    """When a measurement was made, Unix time, s, and one standard deviation of that, s."""

    t: float
    std: float


class ClockSync:
    """The clocks of one device and of the host. Host times are seconds of `time.monotonic`.

    Args:
        latency: s from a measurement to the time in its frame, or to the begin of its line; None: not known, which is
            nothing for a device that answers pings, and about half a period for one that prints lines.
    """

    def __init__(self, latency: float | None = None) -> None:
        self._latency = latency or 0.0
        self._pings = PingClock()
        self._arrivals = ArrivalClock(latency)
        self._wall = WallClock()
        self._std = float("nan")

    @property
    def ping_answered(self) -> bool:
        """Whether the device has answered a ping since its boot."""
        return self._pings.synchronised

    def restart(self) -> None:
        """Forgets the device's clock: the device restarted."""
        self._pings.restart()
        self._arrivals.restart()

    def observe_host(self, at: float, unix: float) -> None:
        """Learns that host time `at`, s, was Unix time `unix`, s."""
        self._wall.observe(at, unix)

    def add_ping(self, sent: float, received: float, device_time: float) -> None:
        """Learns from a ping: sent and its reply read at these host times, s, answered at that device time, s."""
        self._pings.add_ping(sent, received, device_time)

    def timestamp(self, tracked: TrackedMeasurement, two_way: bool) -> Timestamp:
        """When a measurement was made; for a device that answers pings only once it has answered one."""
        host: HostTime | None
        if two_way:
            assert tracked.device_time is not None
            host = self._pings.host_time(tracked.device_time)
            assert host is not None
            host = HostTime(host.at - self._latency, host.std)
        else:
            host = self._arrivals.host_time(tracked.at, tracked.transmission, tracked.device_time)
            self._latency = self._arrivals.latency
        self._std = host.std
        return Timestamp(self._wall.unix(host.at), host.std)

    def state(self, synchronised: bool) -> ClockState:
        """How the clocks compare, for the device's status."""
        return ClockState(
            synchronised, self._pings.drift, self._std, self._pings.round_trip, self._wall.jumps, self._latency
        )
