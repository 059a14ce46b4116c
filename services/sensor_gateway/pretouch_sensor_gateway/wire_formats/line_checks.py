"""Checks over several lines: what no single line shows, and what would make false ranges or times."""

from __future__ import annotations

import math
from collections import deque
from itertools import pairwise
from statistics import median

_WINDOW = 12
"""Ranges that are compared."""
_LEAST_DIFFERENCE = 0.004
"""Metres between two sensors, at least, for their lines to be told apart from noise."""
_STEPS = 3
"""Steps of a time, at least, before its unit is doubted."""
_FASTEST, _SLOWEST = 400.0, 5e6
"""Microseconds from line to line that a device's time can take: 2.5 kHz to 0.2 Hz."""


class AlternationCheck:
    """Detects two sensors that print on alternate lines, neither of which is named.

    Every range then lies on the other side of the one before, far from it and near the one before that. The noise of
    one sensor does not: its ranges differ as much from the second last as from the last. Once detected, it stays: when
    both sensors see the same distance nothing tells them apart.
    """

    def __init__(self) -> None:
        self.detected = False
        self._ranges: deque[float] = deque(maxlen=_WINDOW)

    def add(self, metres: float, quantum: float) -> None:
        """Adds the range of the next line; `quantum` is the step of its last digit, m."""
        if math.isnan(metres) or self.detected:
            return
        self._ranges.append(metres)
        if len(self._ranges) < _WINDOW:
            return
        ranges = list(self._ranges)
        steps = [after - before for before, after in pairwise(ranges)]
        if any(before * after >= 0 for before, after in pairwise(steps)):
            return
        same_sensor = [abs(after - before) for before, after in zip(ranges, ranges[2:], strict=False)]
        difference = median(map(abs, steps))
        least = max(_LEAST_DIFFERENCE, 2.5 * quantum, 3 * median(same_sensor))
        self.detected = difference >= least and min(map(abs, steps)) > max(same_sensor) / 2

    def restart(self) -> None:
        """Forgets all lines: another device may be on the port."""
        self.detected = False
        self._ranges.clear()


class TimeCheck:
    """Detects a time whose unit is not the stated one: it runs far too fast or too slowly from line to line.

    Args:
        modulus: microseconds at which the time wraps.
    """

    def __init__(self, modulus: int) -> None:
        self._modulus = modulus
        self._last: int | None = None
        self._steps: deque[int] = deque(maxlen=9)

    def add(self, micros: int) -> float | None:
        """The microseconds from line to line that are not possible; None if they are, or nothing is known yet."""
        if self._last is not None:
            self._steps.append((micros - self._last) % self._modulus)
        self._last = micros
        if len(self._steps) < _STEPS:
            return None
        step = median(self._steps)
        return None if _FASTEST <= step <= _SLOWEST else step

    def restart(self) -> None:
        """Forgets all lines: another device may be on the port."""
        self._last = None
        self._steps.clear()
