"""Detects ranges that jump: time-of-flight modules report a wild range with a good status now and then."""

from __future__ import annotations

import math
from collections.abc import Sequence

SIGMAS = 8.0
"""Standard deviations of the module's noise between two ranges of it that are no jump."""
SPEED = 0.05
"""m/s at which ranges change beside that: a tip at 5 cm/s over a slope of 45 degrees."""
_LONGEST = 1.0
"""s after which the way that the surface may have moved grows no more."""


class JumpDetector:
    """Compares each module's range with its earlier ones.

    A range is a jump if it is further from the module's last confirmed range than noise and the tip's motion explain;
    while the noise is not known, nothing is. The edge of an object is a jump too, but a lasting one: a second range
    near it confirms it. So at an edge one range is flagged, and a wild reading is always flagged. A measurement without
    a range changes nothing.
    """

    def __init__(self) -> None:
        self._confirmed: list[float] = []
        self._candidate: list[float] = []
        self._last: list[float] = []  # when the confirmed one was made

    def restart(self) -> None:
        """Forgets all ranges: the device may have been moved, or replaced by another."""
        self._confirmed, self._candidate = [], []

    def detect(self, t: float, ranges: Sequence[float], stds: Sequence[float]) -> list[bool]:
        """For each of k modules, whether its range, m, NaN for none, is a jump.

        Starts over when the number of modules changes.

        Args:
            t: when they were made, s.
            stds: (k,), m, one standard deviation of each range; NaN: not known.
        """
        if len(self._confirmed) != len(ranges):
            self._confirmed = [math.nan] * len(ranges)
            self._candidate = [math.nan] * len(ranges)
            self._last = [t] * len(ranges)
        jumps = [False] * len(ranges)
        for k, (metres, std) in enumerate(zip(ranges, stds, strict=True)):
            if math.isnan(metres):
                continue
            most = SIGMAS * std + SPEED * min(max(t - self._last[k], 0.0), _LONGEST)
            if abs(metres - self._confirmed[k]) > most and not abs(metres - self._candidate[k]) <= most:
                self._candidate[k] = metres
                jumps[k] = True
            else:
                self._confirmed[k], self._candidate[k], self._last[k] = metres, math.nan, t
        return jumps
