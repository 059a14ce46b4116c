"""Statistics of the readings at one distance: outliers, noise, and the step that readings are multiples of."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from pretouch.geometry import Array
from pretouch_sensor_gateway.calibration.record import Point

_REJECTED = 5.0
"""Standard deviations from the median at which a reading is an outlier: of a million good ones, one."""
_MAD_TO_STD = 1.4826
"""Of a normal distribution."""
_LEAST_SPREAD = 5e-5
"""m: least spread assumed, so that readings that nearly agree do not make an outlier of one that is slightly off."""
_UNIT = 1e-5
"""m: a tenth of the finest step that a wire format can send."""

_LEAST_RETURNS = 10
_LEAST_SHARE = 0.25
"""Of the measurements at a distance for which a module must have a range to be used there."""


def split_by_module(raw: Array) -> list[Array]:
    """Each module's readings (n,) out of raw (f, k), NaN where it has none; (0,) of a module with too few returns."""
    least = max(_LEAST_RETURNS, _LEAST_SHARE * len(raw))
    columns = [column[np.isfinite(column)] for column in raw.T]
    return [column if len(column) >= least else column[:0] for column in columns]


def find_step(readings: Iterable[Array]) -> float:
    """The step, m, that all readings are multiples of; 0 if none is visible."""
    units = np.unique(np.concatenate(list(readings))) / _UNIT
    whole = np.round(units)
    if len(whole) < 2 or np.abs(units - whole).max() > 0.1:
        return 0.0
    return float(np.gcd.reduce(np.diff(whole).astype(np.int64)) * _UNIT)


def reject_outliers(distance: float, readings: Array, step: float) -> Point:
    """Separates the outliers from readings (n,), m, n > 0, finite.

    An outlier lies more than five standard deviations from the median, these estimated from the median absolute
    deviation, and never less than half a step: where the noise is less than a step, most readings agree.
    """
    deviation = np.abs(readings - np.median(readings))
    width = max(_MAD_TO_STD * float(np.median(deviation)), step / 2, _LEAST_SPREAD)
    outlying = deviation > _REJECTED * width
    kept = readings[~outlying]
    std = float(kept.std(ddof=1)) if len(kept) > 1 else 0.0
    outliers = tuple(round(float(reading), 7) for reading in readings[outlying])
    return Point(distance, round(float(kept.mean()), 7), round(std, 7), len(kept), outliers)


def noise_std(readings: Array) -> float:
    """One standard deviation, m, of readings (n,) without the outliers; not less than rounding alone makes."""
    step = find_step([readings])
    return max(reject_outliers(0.0, readings, step).std, step / float(np.sqrt(12)))
