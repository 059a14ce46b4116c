"""What a calibration leaves: an error of the range that is a smooth function of the range."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import legval

from pretouch.geometry import Array
from pretouch_simulation.fingers.cone_response import CALIBRATED_AT

_FROM, _TO = 0.01, 0.10
"""m: the span that the module was calibrated over; beyond it the error is that of the span's end."""


@dataclass(frozen=True)
class RangeCurve:
    """An error over the range, 0 where the module was calibrated on a wall.

    Attributes:
        gain: the error of the slope.
        shape: m, coefficients of the Legendre polynomials over the span from the degree 2 on, each of the rms that
            it adds.
    """

    gain: float = 0.0
    shape: tuple[float, ...] = ()

    def __call__(self, ranges: Array) -> Array:
        """(n,), m, of ranges (n,), m."""
        return self.gain * (ranges - CALIBRATED_AT) + self._bend(ranges) - self._bend(np.array(CALIBRATED_AT))

    def _bend(self, ranges: Array) -> Array:
        place = (2 * np.clip(ranges, _FROM, _TO) - _FROM - _TO) / (_TO - _FROM)
        degrees = np.arange(2, 2 + len(self.shape))
        return np.asarray(legval(place, [0.0, 0.0, *(np.array(self.shape) * np.sqrt(2 * degrees + 1))]))
