"""How far apart moments usually are."""

from __future__ import annotations

from collections import deque
from statistics import median

REMEMBERED = 32
"""Intervals of which the median is taken."""
ASSUMED = 0.1
"""Seconds between two lines, until two were heard."""
_EVERY = 8
"""Intervals after which the medians are taken anew, once there are enough."""
_NORMAL = 1.4826
"""Standard deviation of a normal distribution per median absolute deviation."""


class IntervalStatistics:
    """The recent intervals between moments that grow; equal ones count once, and a pause is one odd interval of many.

    Attributes:
        typical: their median, s.
        spread: one standard deviation by their median absolute deviation, s.
    """

    def __init__(self) -> None:
        self.typical = ASSUMED
        self.spread = 0.0
        self._heard = 0
        self._last: float | None = None
        self._recent: deque[float] = deque(maxlen=REMEMBERED)

    def observe(self, moment: float) -> None:
        if self._last is not None and moment > self._last:
            self._recent.append(moment - self._last)
            self._heard += 1
            if self._heard < REMEMBERED or self._heard % _EVERY == 0:
                self.typical = median(self._recent)
                self.spread = _NORMAL * median(abs(interval - self.typical) for interval in self._recent)
        self._last = moment

    def restart(self) -> None:
        """The next moment is no interval away from the last; the intervals stay what they were."""
        self._last = None
