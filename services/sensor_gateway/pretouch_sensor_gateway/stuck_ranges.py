"""Notices a module whose range never changes, as of a frozen library or a covered sensor."""

from __future__ import annotations

import numpy as np

from pretouch.geometry import Array
from pretouch_sensor_gateway.range_batch import RangeBatch

_STUCK = 300
"""Measurements with the same range: the noise of a sensor with steps of 1 mm moves its last digit far sooner."""
_COARSE = 10
"""How many times more a sensor with steps of 1 cm may show."""


class StuckRanges:
    """Counts for each module how long its range has been the same; ranges are as the device reports them."""

    def __init__(self) -> None:
        self._last: Array = np.zeros(0)
        self._counts = np.zeros(0, dtype=np.int64)

    def add(self, batch: RangeBatch) -> None:
        for ranges in batch.raw:
            if len(ranges) != len(self._last):
                self._last, self._counts = np.full(len(ranges), np.nan), np.zeros(len(ranges), dtype=np.int64)
            self._counts = np.where(ranges == self._last, self._counts + 1, 0)
            self._last = ranges

    def problem(self) -> str:
        """Which module is stuck, in a sentence; "" if none is."""
        coarse = np.abs(self._last * 100 - np.round(self._last * 100)) < 1e-9
        limits = np.where(coarse, _COARSE * _STUCK, _STUCK)
        stuck = np.flatnonzero(self._counts >= limits)
        if not len(stuck):
            return ""
        module = int(stuck[0])
        return (
            f"Module {module} has shown {self._last[module] * 1000:g} mm {self._counts[module] + 1} times in a row, "
            "without any noise: is its program frozen, or the sensor covered?"
        )
