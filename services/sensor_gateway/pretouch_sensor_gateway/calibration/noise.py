"""Fits how a module's noise grows with the distance."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pretouch.geometry import Array
from pretouch_sensor_gateway.calibration.model import ModuleCalibration
from pretouch_sensor_gateway.calibration.record import Point

LEAST_STD = 1e-5
"""m: no module is better; it also keeps weights finite."""
SIGNIFICANT = 2.0
"""Standard errors beyond which a parameter is taken; it is 0 within them."""
_ROUNDS = 5


class Noise(NamedTuple):
    """std + std_slope * distance, m and 1, with standard errors."""

    std: float
    std_slope: float
    std_error: float
    std_slope_error: float


def fit_noise(points: Sequence[Point], model: ModuleCalibration, step: float) -> Noise:
    """The noise of calibrated ranges: a straight line through the standard deviations at each distance.

    A standard deviation of n readings has the relative standard error 1 / sqrt(2 (n - 1)). It is never taken for less
    than step / sqrt(12), the error of rounding: where the noise is less than a step, the readings hide it. A slope that
    is not significant, or negative, is 0.
    """
    r = np.array([point.distance for point in points])
    rounding = step / np.sqrt(12)
    stds = np.maximum([point.std for point in points], max(rounding, LEAST_STD)) * model.gain(r)
    counts = np.array([max(point.samples - 1, 1) for point in points])
    level = _line(np.ones((len(r), 1)), stds, counts)
    if len(r) > 1:
        line = _line(np.stack([np.ones_like(r), r], axis=1), stds, counts)
        if line[0][1] > SIGNIFICANT * line[1][1]:
            return _above(line, r, stds, max(rounding, LEAST_STD))
    return Noise(float(level[0][0]), 0.0, float(level[1][0]), 0.0)


def _above(line: tuple[Array, Array], r: Array, stds: Array, least: float) -> Noise:
    """The line, turned about its least value at distance 0 if it starts below."""
    (start, slope), (start_error, slope_error) = line
    if start < least:
        start, slope = least, max(float(r @ (stds - least) / (r @ r)), 0.0)
    return Noise(float(start), float(slope), float(start_error), float(slope_error))


def _line(columns: Array, stds: Array, counts: Array) -> tuple[Array, Array]:
    """Weighted least squares, and standard errors; the weights come from the line itself, a few times over."""
    expected = np.full(len(stds), stds.mean())
    for _ in range(_ROUNDS):
        weights = 2 * counts / expected**2
        covariance = np.linalg.inv(columns.T @ (weights[:, None] * columns))
        values = covariance @ (columns.T @ (weights * stds))
        expected = np.maximum(columns @ values, 0.1 * stds.mean())
    return values, np.sqrt(np.diag(covariance))
