"""The residual error after calibration: a smooth function of the range."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import legval

from pretouch.geometry import Array
from pretouch_simulation.fingers.cone_response import CALIBRATED_AT


@dataclass(frozen=True)
class RangeCurve:
    """An error over the range, 0 where the module was calibrated on a wall.

    Attributes:
        span: m, the calibrated interval of ranges; beyond it the bend stays that of the nearer end.
        gain: the error of the slope.
        bend: m, the rms of each Legendre component over the span, from degree 2 on.
    """

    span: tuple[float, float]
    gain: float = 0.0
    bend: tuple[float, ...] = ()

    def __call__(self, ranges: Array) -> Array:
        """(n,), m, of ranges (n,), m."""
        return self.gain * (ranges - CALIBRATED_AT) + self._bend(ranges) - self._bend(np.array(CALIBRATED_AT))

    def _bend(self, ranges: Array) -> Array:
        low, high = self.span
        place = (2 * np.clip(ranges, low, high) - low - high) / (high - low)
        degrees = np.arange(2, 2 + len(self.bend))
        return np.asarray(legval(place, [0.0, 0.0, *(np.array(self.bend) * np.sqrt(2 * degrees + 1))]))
