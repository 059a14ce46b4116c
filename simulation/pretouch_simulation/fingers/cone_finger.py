"""A fingertip whose module sees a cone, with the errors between the noiseless reading and the reported one."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch.tof import Sensor
from pretouch_simulation.fingers.cone_response import ConeResponse, Reflectances
from pretouch_simulation.fingers.range_curve import RangeCurve
from pretouch_simulation.fingers.status import Status
from pretouch_simulation.world import World

_NOISE_SCALE = (0.7, 1.4)
_EARLY = 0.3
"""Share of the flagged measurements with the status of early convergence; the others report a poor signal."""


@dataclass(frozen=True)
class Errors:
    """Errors of a module's readings.

    Attributes:
        noise: m, standard deviation of one range on the calibration's wall; elsewhere it goes with the signal^-1/2, as
            shot noise, within 0.7 to 1.4 times.
        bias: m, standard deviation of the bias of a scan, the same for all its ranges.
        curve: the error as a function of the range.
        step: m, to which ranges are rounded; 0 for none.
        least_range: m; anything nearer underflows.
        least_signal: below it, of the calibration's wall, there is no return.
        flagged, outliers: share of measurements that fail with an error status, and that are outliers with a good one.
    """

    noise: float
    bias: float
    curve: RangeCurve
    step: float
    least_range: float
    least_signal: float
    flagged: float
    outliers: float

    def round_to_step(self, ranges: Array) -> Array:
        """(n,), m, of ranges (n,), m."""
        if not self.step:
            return ranges
        return np.asarray(np.round(ranges / self.step) / round(1 / self.step), dtype=np.float64)


@dataclass(frozen=True)
class ConeFinger:
    """A `Finger` with one module."""

    sensor: Sensor
    response: ConeResponse
    errors: Errors
    reflectances: Reflectances = field(default_factory=Reflectances)

    def begin_scan(self, count: int, rng: np.random.Generator) -> _Measurements:
        """See `Finger.begin_scan`."""
        bias = self.errors.bias * float(rng.standard_normal())
        return _Measurements(self, bias, rng.standard_normal(count), rng.uniform(size=(3, count)))


@dataclass(frozen=True)
class _Measurements:
    finger: ConeFinger
    bias: float
    normal: Array
    uniform: Array

    def take(self, world: World, base_T_module: Array, first: int = 0) -> tuple[Array, NDArray[np.int64]]:
        """See `Measurements.take`."""
        n, errors, sensor = len(base_T_module), self.finger.errors, self.finger.sensor
        normal = self.normal[first : first + n]
        chance, which, anywhere = self.uniform[:, first : first + n]
        true, signal = self.finger.response.read(world, base_T_module, self.finger.reflectances)
        answered = np.isfinite(true) & (signal >= errors.least_signal)
        met = np.where(answered, true, sensor.range_max)
        spread = errors.noise * np.clip(np.maximum(signal, 1e-9) ** -0.5, *_NOISE_SCALE)
        ranges = errors.round_to_step(met + errors.curve(met) + self.bias + spread * normal)

        status = np.full(n, Status.OK, dtype=np.int64)
        status[ranges > sensor.range_max] = Status.NO_TARGET
        status[(met < errors.least_range) | (ranges < sensor.range_min)] = Status.RANGE_UNDERFLOW
        flagged = chance < errors.flagged
        status[flagged] = np.where(which < _EARLY, Status.EARLY_CONVERGENCE, Status.SNR)[flagged]
        status[~answered] = Status.NO_TARGET
        outlier = chance > 1 - errors.outliers
        spurious = sensor.range_min + anywhere * (sensor.range_max - sensor.range_min)
        ranges[outlier] = errors.round_to_step(spurious)[outlier]
        status[outlier] = Status.OK
        return np.where(status == Status.OK, ranges, np.nan), status
