"""Estimates when a line was measured from when it arrived, for devices that answer no pings."""

from __future__ import annotations

from math import sqrt

from pretouch_sensor_gateway.clock.arrival_envelope import LATENCY, ArrivalEnvelope
from pretouch_sensor_gateway.clock.interval_statistics import IntervalStatistics
from pretouch_sensor_gateway.clock.ping_clock import HostTime


class ArrivalClock:
    """Times of the lines of one boot session.

    A line is measured `latency` before it began. Where that is not known, it is assumed to have been measured at some
    unknown moment within the period before: hence half a period earlier, with period / sqrt(12) as a standard
    deviation, the same for all lines.

    - A line without a time of its own began when its last byte was read, less its time on the wire. The period is the
      median between two reads: lines that arrive in one read cannot be told apart. Delays add to the deviation: their
      root mean square is sqrt(2) of the spread of the intervals if they are uniform from none, and at least that of a
      latency timer, which need not show in the intervals.
    - A line that contains the device's time, taken when the line was made, began at that time, mapped to host time by
      the envelope of arrivals, and never after it arrived. The period is the median by the device's clock.

    Args:
        latency: s from a measurement to the begin of its line; None: not known.

    Attributes:
        latency: as given, or as it was last assumed.
    """

    def __init__(self, latency: float | None = None) -> None:
        self.latency = latency or 0.0
        self._known = latency is not None
        self._reads = IntervalStatistics()
        self._made = IntervalStatistics()
        self._envelope = ArrivalEnvelope()

    def host_time(self, arrival: float, transmission: float, device: float | None) -> HostTime:
        """When the measurement of a line was made; to be called once for each line, in their order.

        Args:
            arrival: host time at which its last byte was read, s.
            transmission: s that it took on the wire.
            device: its time on the device's clock, s, unwrapped; None if it has none.
        """
        begin = arrival - transmission
        if device is None:
            self._reads.observe(arrival)
            period, variance = self._reads.typical, max(2 * self._reads.spread**2, LATENCY**2 / 3)
        else:
            self._made.observe(device)
            self._envelope.observe(begin, device)
            expected, variance = self._envelope.at(device)
            begin, period = min(begin, expected), self._made.typical
        if not self._known:
            self.latency = period / 2
            variance += period * period / 12
        return HostTime(begin - self.latency, sqrt(variance))

    def restart(self) -> None:
        """Forgets the device's clock, but not its period: the device restarted."""
        self._reads.restart()
        self._made.restart()
        self._envelope.restart()
