"""The noise of uncalibrated modules, measured in what they send."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch_sensor_gateway.calibration.readings import find_step

WINDOW = 96
"""Newest measurements that count."""
LEAST = 24
"""Second differences from which on a noise is known."""
_EVERY = 32
"""Measurements between two estimates."""
_TRIMMED = 4.0
"""Standard deviations beyond which a second difference is an edge or an outlier."""
_MAD_TO_STD = 1.4826


class OwnNoise:
    """The standard deviation of each module's ranges, from their second differences.

    x[n] - (x[n - 1] + x[n + 1]) / 2 is free of a surface that approaches steadily, and has 1.5 times the variance of
    independent noise; edges and outliers are trimmed. It tells nothing of errors that successive ranges share. A module
    whose ranges never change tells nothing at all.
    """

    def __init__(self) -> None:
        self._ranges = np.zeros((0, 0))
        self._std = np.zeros(0)
        self._count = 0

    def restart(self) -> None:
        """Forgets everything: another device may be connected."""
        self._ranges = np.zeros((0, 0))

    def observe(self, ranges: Array) -> NDArray[np.float32]:
        """(f, k), m, NaN while unknown: the noise when each of f measurements (f, k), m, NaN for none, was made."""
        modules = ranges.shape[1]
        if self._ranges.shape[1] != modules:
            self._ranges, self._std, self._count = np.full((WINDOW, modules), np.nan), np.full(modules, np.nan), 0
        found = np.empty(ranges.shape, dtype=np.float32)
        for n, row in enumerate(ranges):
            self._ranges[self._count % WINDOW] = row
            self._count += 1
            if self._count % _EVERY == 0:
                ordered = np.roll(self._ranges, -(self._count % WINDOW), axis=0)
                self._std = np.array([_noise(column) for column in ordered.T])
            found[n] = self._std
        return found


def _noise(ranges: Array) -> float:
    """One standard deviation, m, of ranges (n,), m, NaN for none; NaN if they are too few or all the same."""
    second = np.abs(ranges[1:-1] - (ranges[:-2] + ranges[2:]) / 2)
    second = second[np.isfinite(second)]
    if len(second) < LEAST:
        return np.nan
    step = find_step([ranges[np.isfinite(ranges)]])
    kept = second[second <= _TRIMMED * max(_MAD_TO_STD * float(np.median(second)), step)]
    return max(float(np.sqrt(np.mean(kept**2) / 1.5)), step / np.sqrt(12)) or np.nan
