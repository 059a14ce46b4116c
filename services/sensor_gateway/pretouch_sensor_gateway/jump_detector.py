"""Detects ranges that jump: time-of-flight modules report a wild range with a good status now and then."""

from __future__ import annotations

import math
from collections.abc import Sequence

from pretouch_sensor_gateway.wire_formats.parser import OK

MAX_STEP = 0.012
"""Metres between two ranges of one module that are no jump: eight sigma of a good sensor, and more than the surface
moves between two measurements of a scan (1.7 mm at 5 cm/s and 30 Hz on a slope of 45 degrees)."""


class JumpDetector:
    """Compares each module's range with its earlier ones.

    A range is a jump if it is further than `MAX_STEP` from the module's last confirmed range. The edge of an object is
    a jump too, but a lasting one: a second range near it confirms it. So at an edge one range is flagged, and a wild
    reading is always flagged. A measurement without a range changes nothing.
    """

    def __init__(self) -> None:
        self._confirmed: list[float] = []
        self._candidate: list[float] = []

    def restart(self) -> None:
        """Forgets all ranges: the device may have been moved, or replaced by another."""
        self._confirmed, self._candidate = [], []

    def detect(self, ranges: Sequence[float], status: Sequence[int]) -> list[bool]:
        """For each of k modules, whether its range, m, is a jump. Starts over when the number of modules changes."""
        if len(self._confirmed) != len(ranges):
            self._confirmed = [math.nan] * len(ranges)
            self._candidate = [math.nan] * len(ranges)
        jumps = [False] * len(ranges)
        for k, (metres, code) in enumerate(zip(ranges, status, strict=True)):
            if code != OK or math.isnan(metres):
                continue
            if abs(metres - self._confirmed[k]) > MAX_STEP and not abs(metres - self._candidate[k]) <= MAX_STEP:
                self._candidate[k] = metres
                jumps[k] = True
            else:
                self._confirmed[k], self._candidate[k] = metres, math.nan
        return jumps
