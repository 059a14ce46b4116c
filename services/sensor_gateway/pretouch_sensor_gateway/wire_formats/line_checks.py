"""Checks over several lines: what no single line shows, and what would make false ranges or times."""

from __future__ import annotations

import re
from collections import deque
from itertools import pairwise
from statistics import median

_WINDOW = 12
"""Ranges that are compared."""
_LEAST_DIFFERENCE = 0.004
"""Metres between two sensors, at least, for their lines to be told apart from noise."""
_DECIMALS = re.compile(r"[.,](\d+)")
_STEPS = 3
"""Steps of a time, at least, before its unit is doubted."""
_FASTEST, _SLOWEST = 400.0, 5e6
"""Microseconds from line to line that a device's time can take: 2.5 kHz to 0.2 Hz."""


class AlternationCheck:
    """Detects two sensors that print on alternate lines, neither of which is named.

    Every range then lies on the other side of the one before, far from it and near the one before that. The noise of
    one sensor does not: its ranges differ as much from the second last as from the last. Once detected, it stays: when
    both sensors see the same distance nothing tells them apart.

    Args:
        unit: of the numbers on the lines, m.
    """

    def __init__(self, unit: float) -> None:
        self.detected = False
        self._unit = unit
        self._ranges: deque[float] = deque((0.0,), maxlen=_WINDOW)
        self._rose = False
        self._turns = 0  # steps in a row, each the other way than the one before

    def add(self, metres: float, text: str) -> None:
        """Adds the range of the next line, which says `text`; NaN for none."""
        if metres != metres or self.detected:
            return
        step = metres - self._ranges[-1]
        self._ranges.append(metres)
        rises = step > 0
        self._turns = self._turns + 1 if step and rises != self._rose else 0
        self._rose = rises
        if self._turns >= _WINDOW - 1:
            decimals = _DECIMALS.search(text)
            self.detected = self._is_of_two(self._unit / 10 ** (len(decimals[1]) if decimals else 0))

    def _is_of_two(self, quantum: float) -> bool:
        """Whether the last ranges, each on the other side of the one before, are of two sensors.

        Args:
            quantum: step of a line's last digit, m.
        """
        ranges = list(self._ranges)
        steps = [abs(after - before) for before, after in pairwise(ranges)]
        same_sensor = [abs(after - before) for before, after in zip(ranges, ranges[2:], strict=False)]
        least = max(_LEAST_DIFFERENCE, 2.5 * quantum, 3 * median(same_sensor))
        return median(steps) >= least and min(steps) > max(same_sensor) / 2


class TimeCheck:
    """Detects a time whose unit is not the stated one: it runs far too fast or too slowly from line to line.

    Args:
        modulus: microseconds at which the time wraps.
    """

    def __init__(self, modulus: int) -> None:
        self._modulus = modulus
        self._last: int | None = None
        self._steps: deque[int] = deque(maxlen=9)
        self._doubted = 0  # steps since the last impossible one, counted down

    def add(self, micros: int) -> float | None:
        """The microseconds from line to line that are not possible; None if they are, or nothing is known yet."""
        last, self._last = self._last, micros
        if last is None:
            return None
        step = (micros - last) % self._modulus
        self._steps.append(step)
        self._doubted = self._doubted - 1 if _FASTEST <= step <= _SLOWEST else 9
        if self._doubted <= 0 or len(self._steps) < _STEPS:
            return None
        typical = median(self._steps)
        return None if _FASTEST <= typical <= _SLOWEST else typical
