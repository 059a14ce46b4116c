"""The typical interval between moments, and its spread."""

from __future__ import annotations

from collections import deque
from statistics import median

REMEMBERED = 32
"""Intervals of which the median is taken."""
ASSUMED = 0.1
"""Seconds between two lines, until two have arrived."""
_EVERY = 8
"""Intervals after which the medians are computed again, once there are enough."""
_NORMAL = 1.4826
"""Standard deviation of a normal distribution per median absolute deviation."""


class IntervalStatistics:
    """Robust statistics of the recent intervals between increasing moments; equal moments count once.

    Attributes:
        typical: their median, s.
        spread: one standard deviation by their median absolute deviation, s.
    """

    def __init__(self) -> None:
        self.typical = ASSUMED
        self.spread = 0.0
        self._count = 0
        self._last: float | None = None
        self._recent: deque[float] = deque(maxlen=REMEMBERED)

    def observe(self, moment: float) -> None:
        if self._last is not None and moment > self._last:
            self._recent.append(moment - self._last)
            self._count += 1
            if self._count < REMEMBERED or self._count % _EVERY == 0:
                self.typical = median(self._recent)
                self.spread = _NORMAL * median(abs(interval - self.typical) for interval in self._recent)
        self._last = moment

    def restart(self) -> None:
        """Starts a new series: the next moment forms no interval with the last. Earlier intervals are kept."""
        self._last = None
