"""Flags ranges that jump: time-of-flight modules report a wild range with a good status now and then."""

from __future__ import annotations

import math
from collections.abc import Sequence

from pretouch_sensor_gateway.wire_formats.received import OK

STEP = 0.012
"""Metres between two ranges of one module that are no jump: eight sigma of a good sensor, and more than the surface
moves between two measurements of a scan (1.7 mm at 5 cm/s and 30 Hz on a slope of 45 degrees)."""


class Jumps:
    """Judges one module after the other, measurement by measurement.

    A range is a jump if it is further than `STEP` from the module's last believed range. The edge of an object is one
    too, but goes on: a second range near the jump confirms it. So of an edge one range is flagged, of an outlier all.
    A measurement without a range changes nothing.
    """

    def __init__(self) -> None:
        self._believed: list[float] = []
        self._candidate: list[float] = []

    def restart(self) -> None:
        """Forgets what was believed: the device may have been moved, or be another."""
        self._believed, self._candidate = [], []

    def judge(self, ranges: Sequence[float], status: Sequence[int]) -> list[bool]:
        """Of each of k modules, whether its range, m, jumps. Another number of modules starts over."""
        if len(self._believed) != len(ranges):
            self._believed = [math.nan] * len(ranges)
            self._candidate = [math.nan] * len(ranges)
        jumps = [False] * len(ranges)
        for k, (metres, code) in enumerate(zip(ranges, status, strict=True)):
            if code != OK or math.isnan(metres):
                continue
            if abs(metres - self._believed[k]) > STEP and not abs(metres - self._candidate[k]) <= STEP:
                self._candidate[k] = metres
                jumps[k] = True
            else:
                self._believed[k], self._candidate[k] = metres, math.nan
        return jumps
