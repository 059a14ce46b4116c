"""Maps a device's clock to the host's by the lower envelope of arrivals, for devices that answer no pings.

A line arrives late by the delays of the operating system, USB and its latency timer, never early. So the arrivals of
least lateness, one for each second, follow the device's clock; the same fit as for pings is made through them, with
less weight the more an arrival lies above the previous fit. (Moon, Skelly and Towsley, Estimation and removal of clock
skew from network delay measurements, 1999, take the convex hull, which does not allow for a wandering oscillator.)
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np

from pretouch_sensor_gateway.clock.clock_fit import MEMORY, ClockFit, fit_clock
from pretouch_sensor_gateway.clock.thinning_buffer import ThinningBuffer

LATENCY = 0.016
"""Seconds that a USB serial converter may hold back what it has: the latency timer of the most common one."""
LEAST_LATENCY = 1e-3
"""Standard deviation, s, of the unknown delay of even the quickest line: a USB frame, a scheduler."""
SPAN, FIRST_SPAN = 1.0, 0.1
"""Seconds of each span, of which the least late arrival counts; the first spans grow from the smaller value."""
CONTRADICTION = 5.0
"""Standard deviations from the envelope at which a span contradicts it."""
TOO_EARLY, TOO_LATE = 3, 10
"""Spans in a row that replace the envelope. A host may be busy for seconds; nothing arrives before it was sent."""


@dataclass(frozen=True)
class _Line:
    """Host time at which a line began to arrive, and the device time in it, s."""

    begin: float
    device: float


class ArrivalEnvelope:
    """The clock of one boot session, from the arrival of its lines. Needs one line before it can map a time."""

    def __init__(self) -> None:
        self._lines: ThinningBuffer[_Line] = ThinningBuffer(self._lateness)
        self._fit: ClockFit | None = None
        self._least: _Line | None = None
        self._end = 0.0
        self._early = self._late = 0

    def restart(self) -> None:
        """Forgets the clock: the device restarted."""
        self._lines.clear()
        self._fit = self._least = None
        self._early = self._late = 0

    def observe(self, begin: float, device: float) -> None:
        """Learns from a line that began to arrive at host time `begin`, s, and contains device time `device`, s."""
        line = _Line(begin, device)
        if self._fit is None:
            self._fit_line(line)
        elif self._least is None or self._lateness(line) < self._lateness(self._least):
            self._least = line
        if begin >= self._end and self._least is not None:
            self._close(self._least)
            self._least = None
            self._end = begin + min(SPAN, FIRST_SPAN * len(self._lines))

    def at(self, device: float) -> tuple[float, float]:
        """Host time at which a line of that device time began, and its variance, s^2."""
        assert self._fit is not None
        at, variance = self._fit.at(device)
        return at, variance + LEAST_LATENCY**2

    def _lateness(self, line: _Line) -> float:
        return line.begin - (line.device if self._fit is None else self._fit.at(line.device)[0])

    def _close(self, line: _Line) -> None:
        lateness = self._lateness(line)
        limit = CONTRADICTION * sqrt(self.at(line.device)[1] + LATENCY**2 / 12)
        self._early = self._early + 1 if lateness < -limit else 0
        self._late = self._late + 1 if lateness > limit else 0
        if self._early == TOO_EARLY or self._late == TOO_LATE:
            self.restart()
            self._fit_line(line)
        elif not self._early and not self._late:
            self._fit_line(line)

    def _fit_line(self, newest: _Line) -> None:
        self._lines.append(newest)
        recent = [line for line in self._lines if line.device > newest.device - MEMORY]
        begin, device = np.array([(line.begin, line.device) for line in recent]).T
        lateness = np.array([self._lateness(line) for line in recent]) if self._fit else np.zeros(len(recent))
        above = lateness - lateness.min()
        floor = max(float(np.median(above)) / 2, LATENCY / sqrt(len(above)))
        self._fit = fit_clock(device, begin, (above**2 + floor**2) / 12, np.zeros(len(begin)))
