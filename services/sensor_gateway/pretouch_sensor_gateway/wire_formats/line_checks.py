"""Checks over several lines: what no single line shows, and what would make false ranges or times."""

from __future__ import annotations

import re
from collections import deque
from itertools import pairwise
from statistics import median

_WINDOW = 16
"""Ranges that are compared, at most."""
_LEAST_RANGES = 12
"""And at least."""
_LEAST_DIFFERENCE = 0.004
"""Metres between two sensors, at least, for their lines to be told apart from noise."""
_DECIMALS = re.compile(r"[.,](\d+)")
_STEPS = 3
"""Steps of a time, at least, before its unit is doubted."""
_FASTEST, _SLOWEST = 400.0, 5e6
"""Microseconds from line to line that a device's time can take: 2.5 kHz to 0.2 Hz."""


class TurnsCheck:
    """Detects two to four sensors that print in turns, each on a line of its own, and do not say which they are.

    Every range then lies far from the one before and near the one a turn before, and steps up and down repeat from
    turn to turn. The noise of one sensor does not: its ranges differ as much from the one a turn before as from the
    last. Once detected, it stays: when the sensors see the same distance nothing tells them apart.

    Args:
        unit: of the numbers on the lines, m.
    """

    def __init__(self, unit: float) -> None:
        self.detected = False
        self._unit = unit
        self._ranges: deque[float] = deque(maxlen=_WINDOW)

    def add(self, metres: float, text: str) -> None:
        """Adds the range of the next line, which says `text`; NaN for none."""
        if metres != metres or self.detected:
            return
        ranges = self._ranges
        far = len(ranges) > 0 and abs(metres - ranges[-1]) >= _LEAST_DIFFERENCE
        ranges.append(metres)
        if far and len(ranges) >= _LEAST_RANGES:
            decimals = _DECIMALS.search(text)
            least = max(_LEAST_DIFFERENCE, 2.5 * self._unit / 10 ** (len(decimals[1]) if decimals else 0))
            self.detected = any(self._are_turns_of(sensors, least) for sensors in (2, 3, 4))

    def _are_turns_of(self, sensors: int, least: float) -> bool:
        """Whether the last ranges are of so many sensors, at least `least` m apart."""
        ranges = list(self._ranges)
        if len(ranges) < max(_LEAST_RANGES, 4 * sensors):
            return False
        steps = [after - before for before, after in pairwise(ranges)]
        if any(before * after < 0 for before, after in zip(steps, steps[sensors:], strict=False)):
            return False
        moved = [abs(after - before) for before, after in zip(ranges, ranges[sensors:], strict=False)]
        apart = [abs(step) for step in steps]
        back = any(step < 0 for step in steps) and any(step > 0 for step in steps)
        return (
            back
            and median(apart) >= max(least, 3 * median(moved))
            and min(sorted(apart)[len(apart) // 2 :]) > max(moved) / 2
        )


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
