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


@dataclass(frozen=True)
class ConeFinger:
    """A `Finger` with one module."""

    sensor: Sensor
    response: ConeResponse
    errors: Errors
    reflectances: Reflectances = field(default_factory=Reflectances)

    def measure(self, world: World, base_T_module: Array, rng: np.random.Generator) -> tuple[Array, NDArray[np.int64]]:
        """See `Finger.measure`."""
        n, errors, sensor = len(base_T_module), self.errors, self.sensor
        bias, normal = errors.bias * rng.standard_normal(), rng.standard_normal(n)
        chance, which, anywhere = rng.uniform(size=(3, n))
        true, signal = self.response.read(world, base_T_module, self.reflectances)
        answered = np.isfinite(true) & (signal >= errors.least_signal)
        met = np.where(answered, true, sensor.range_max)
        spread = errors.noise * np.clip(np.maximum(signal, 1e-9) ** -0.5, *_NOISE_SCALE)
        ranges = self._round_to_step(met + errors.curve(met) + bias + spread * normal)

        status = np.full(n, Status.OK, dtype=np.int64)
        status[ranges > sensor.range_max] = Status.NO_TARGET
        status[(met < errors.least_range) | (ranges < sensor.range_min)] = Status.RANGE_UNDERFLOW
        flagged = chance < errors.flagged
        status[flagged] = np.where(which < _EARLY, Status.EARLY_CONVERGENCE, Status.SNR)[flagged]
        status[~answered] = Status.NO_TARGET
        outlier = chance > 1 - errors.outliers
        ranges[outlier] = self._round_to_step(sensor.range_min + anywhere * (sensor.range_max - sensor.range_min))[
            outlier
        ]
        status[outlier] = Status.OK
        return np.where(status == Status.OK, ranges, np.nan), status

    def _round_to_step(self, ranges: Array) -> Array:
        if not self.errors.step:
            return ranges
        return np.asarray(np.round(ranges / self.errors.step) / round(1 / self.errors.step), dtype=np.float64)
