"""Measures, at a target that stands still, how long a module takes to get warm, and the error that a scan's ranges
share.

The ranges of a scan share whatever is slower than the scan. A module's slow noise is roughly of the kind 1 / f, whose
variance between means of a scan's length grows with the logarithm of the time that they cover: over n scans it is

    A^2 n ln n / (2 (n - 1) ln 2),

A^2 being the Allan variance, which does not depend on the time (Barnes, Tables of bias functions, NBS Technical Note
375, 1969). A calibration is used for hours and the drift is measured for minutes, so what was found is extrapolated to
`HORIZON` by that law.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pretouch.errors import InvalidInput
from pretouch.geometry import Array
from pretouch_sensor_gateway.calibration.readings import reject_outliers

SCAN = 6.0
"""s, a scan's usual length."""
HORIZON = 8 * 3600.0
"""s over which a calibration is used."""
LEAST_SCANS = 20
"""The length of a measurement, in scans; half of them may be spent with getting warm."""
_LEAST_SHARE = 0.25
"""Of a scan's measurements for which a module must have a range."""
_EXPLAINED, _OUTSIDE = 0.8, 5.0
"""Share of its time's mean square, and standard deviations of what is left, from which on an exponential is the warming
up."""


@dataclass(frozen=True)
class Drift:
    """The drift of one module.

    Attributes:
        warm_up: s until it was warm, to one standard deviation of its slow noise; 0: it was from the start.
        white_std: one standard deviation of the noise from one range to the next, m.
        found: one standard deviation of the means of a scan's length about their mean, without white noise, m.
        bias_std: the same, extrapolated to `HORIZON`.
        span: s over which `found` was measured, after the warm-up.
    """

    warm_up: float
    white_std: float
    found: float
    bias_std: float
    span: float


def measure_drift(readings: Array, rate: float) -> Drift:
    """The drift of a module.

    Args:
        readings: (n,), m, NaN for none, in the order of time, from when the device was switched on.
        rate: of the measurements, 1/s.

    Raises:
        InvalidInput: too few readings.
    """
    each = max(round(SCAN * rate), 1)
    scans = np.split(readings[: len(readings) // each * each], len(readings) // each) if len(readings) >= each else []
    kept = [scan[np.isfinite(scan)] for scan in scans]
    if len(scans) < LEAST_SCANS or min(map(len, kept)) < max(_LEAST_SHARE * each, 2):
        raise InvalidInput(
            f"There are too few ranges for the drift: {sum(map(len, kept))} in {len(readings) / rate:.0f} s.",
            f"Measure for {LEAST_SCANS * SCAN / 60:.0f} minutes or longer at a target that the module sees well.",
        )
    points = [reject_outliers(0.0, scan, 0.0) for scan in kept]
    means = np.array([point.mean for point in points])
    cold = _count_cold(means)
    white = _find_white(kept)
    warm, counts = means[cold:], np.array([point.samples for point in points[cold:]])
    found = max(float(warm.var(ddof=1) - np.mean(white**2 / counts)), 0.0) ** 0.5
    growth = _growth(HORIZON / SCAN) / _growth(len(warm))
    return Drift(cold * SCAN, white, found, found * max(growth, 1.0) ** 0.5, len(warm) * SCAN)


def _count_cold(means: Array) -> int:
    """How many of them were made before the module was warm.

    The means are fitted with a constant and an exponential that decays to a twentieth within the first half. It is the
    warming up if it explains most of its own time, and starts far outside what is left: slow noise wanders too.
    """
    place = np.arange(len(means))
    best, cold = float(means.var()), 0
    for tau in np.geomspace(1.0, len(means) / 6, 24):
        columns = np.stack([np.ones(len(means)), np.exp(-place / tau)], axis=1)
        fitted = np.linalg.lstsq(columns, means, rcond=None)[0]
        left = means - columns @ fitted
        variance, start = float(np.mean(left**2)), abs(float(fitted[1]))
        early = place < 2 * tau
        explained = 1 - float(np.mean(left[early] ** 2)) / float(np.mean((means[early] - fitted[0]) ** 2) + 1e-30)
        if variance < best and explained > _EXPLAINED and start > _OUTSIDE * variance**0.5:
            best, cold = variance, int(np.ceil(tau * np.log(start / variance**0.5)))
    return min(cold, len(means) // 2)


def _find_white(scans: list[Array]) -> float:
    """One standard deviation of the noise that successive readings do not share, m, without outliers."""
    return float(np.median([reject_outliers(0.0, np.diff(scan), 0.0).std for scan in scans]) / np.sqrt(2))


def _growth(scans: float) -> float:
    """The variance between so many means, in units of A^2 / (2 ln 2)."""
    return float(scans * np.log(scans) / (scans - 1))
