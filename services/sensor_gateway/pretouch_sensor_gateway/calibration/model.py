"""How a module's reading depends on the distance, and back.

The light that a module counts comes from two places: the target at distance r, whose share A / r^2 falls with the
square of the distance, and the cover glass at a distance of about 0, whose share C does not change. The module reports
the mean path of all light, weighted by its share:

    path(r) = (r * A / r^2 + 0 * C) / (A / r^2 + C) = r / (1 + k r^2),        k = C / A, 1/m^2

so k, the crosstalk, is the cover glass's light relative to a target's at one metre. With the module's own offset and
scale the reading is

    raw(r) = offset + scale * r / (1 + k r^2)

It grows with r up to r = 1 / sqrt(k), the module's `reach`, and falls beyond: the glass drowns the target. A reading
above the curve's maximum belongs to no distance. One below it could also come from beyond the reach, and is always
taken for the nearer distance. With y = (raw - offset) / scale, y (1 + k r^2) = r has the nearer root

    r = 2 y / (1 + sqrt(1 - 4 k y^2))

Real modules also bend: pulses saturate, and histograms have bins. What the formula leaves is corrected by a table: the
correction is linear between its distances, constant beyond them, and r + correction(r) grows with r, so that the curve
as a whole can be inverted.

A calibration knows nothing beyond the distances that it was measured at, its `span`. A range there is given, with a
standard deviation that grows by `EXTRAPOLATION` of the way beyond.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pretouch.errors import InvalidInput, Malformed
from pretouch.geometry import Array
from pretouch_sensor_gateway.calibration.mounting import Mounting

MAX_MODULES = 256
MAX_CORRECTIONS = 256
EXTRAPOLATION = 0.2
"""Error of a range beyond the span for each metre beyond; docs/results/calibration.md has measured ones."""
MAX_WARM_UP = 86_400.0
"""s, a day."""
_LIMITS = {
    "offset": (-0.1, 0.1, "m"),
    "scale": (0.5, 2.0, "m of reading for a m of distance"),
    "crosstalk": (0.0, 1e4, "1/m^2"),
    "std": (0.0, 0.1, "m"),
    "std_slope": (0.0, 1.0, "m of noise for a m of distance"),
    "residual": (0.0, 0.1, "m"),
}
_LEAST_STD = 1e-6
"""m; a std of 0 is one that is not known."""


EVERYWHERE = (0.0, math.inf)
"""The span of a calibration that does not say which distances it was measured at."""
MAX_BIAS = 0.1
"""m"""
_MARGIN = 3.0
"""Standard deviations."""


def _finite(value: object, name: str) -> float:
    if (
        isinstance(value, bool)
        or not isinstance(value, int | float | np.floating | np.integer)
        or not math.isfinite(value)
    ):
        raise Malformed(f"{name} is {value!r:.40}.", f"Give {name} as a finite number.")
    return float(value)


def _distance(raw: Array, offset: Array | float, per_scale: Array | float, four_crosstalk: Array | float) -> Array:
    """The inverse of the module docstring's model; quantities that are constant between calls are precomputed."""
    y = np.asarray(np.maximum((raw - offset) * per_scale, 0.0))
    square = np.asarray(1.0 - four_crosstalk * y * y)
    root = np.full_like(square, np.nan)
    np.sqrt(square, out=root, where=square >= 0.0)
    return np.asarray(2.0 * y / (1.0 + root))


def _check_corrections(pairs: Sequence[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    checked = tuple((_finite(place, "corrections"), _finite(added, "corrections")) for place, added in pairs)
    if len(checked) > MAX_CORRECTIONS:
        raise InvalidInput(f"corrections has {len(checked)} pairs.", f"Give at most {MAX_CORRECTIONS}.")
    if checked:
        places, added = np.array(checked).T
        if (np.diff(places) <= 0).any() or (np.diff(places + added) <= 0).any() or np.abs(added).max() > 0.1:
            raise InvalidInput(
                "corrections do not make distances that grow with the reading.",
                "Give distances in ascending order, with corrections of at most 0.1 m that keep that order.",
            )
    return checked


def _spread(
    distance: Array,
    std: Array | float,
    slope: Array | float,
    residual: Array | float,
    start: Array | float,
    end: Array | float,
) -> Array:
    beyond = np.maximum(np.maximum(start - distance, distance - end), 0.0)
    return np.asarray(np.sqrt((std + slope * distance) ** 2 + residual**2 + (EXTRAPOLATION * beyond) ** 2))


@dataclass(frozen=True)
class ModuleCalibration:
    """One module. The defaults are an uncalibrated module, whose readings are taken as distances, of unknown noise.

    Attributes:
        offset: m that it reads at distance 0.
        scale: m read for a m of distance, without crosstalk; 0.5 to 2.
        crosstalk: k of the module's docstring, 1/m^2.
        std: one standard deviation of the noise of a calibrated range at distance 0, m; 0: the noise is not known.
        std_slope: by how much that grows with each m of distance.
        residual: rms error that the curve leaves between the distances that it was fitted to, m.
        corrections: pairs (distance by offset, scale and crosstalk; what is to be added to it), m, by distance.
        span: the least and the greatest distance that was calibrated, m.
        mounting: what a sweep told of its place and its cone; None: nothing yet.

    Raises:
        Malformed: a value is no finite number.
        InvalidInput: a value is beyond what a module can be.
    """

    offset: float = 0.0
    scale: float = 1.0
    crosstalk: float = 0.0
    std: float = 0.0
    std_slope: float = 0.0
    residual: float = 0.0
    corrections: tuple[tuple[float, float], ...] = ()
    span: tuple[float, float] = EVERYWHERE
    mounting: Mounting | None = None

    def __post_init__(self) -> None:
        for name, (least, most, unit) in _LIMITS.items():
            value = _finite(getattr(self, name), name)
            object.__setattr__(self, name, value)
            if not least <= value <= most:
                raise InvalidInput(f"{name} is {value:g}.", f"Need {least:g} to {most:g} {unit}.")
        if 0 < self.std < _LEAST_STD:
            raise InvalidInput(
                f"std is {self.std:g}.", f"Need at least {_LEAST_STD:g} m, or 0 for one that is unknown."
            )
        object.__setattr__(self, "corrections", _check_corrections(self.corrections))
        start, end = self.span
        if self.span != EVERYWHERE and not 0 <= _finite(start, "span") < _finite(end, "span"):
            raise InvalidInput(f"span is {start:g} to {end:g}.", "Give the least and the greatest calibrated distance.")

    @property
    def reach(self) -> float:
        """m: the farthest distance that can be measured; infinite without crosstalk."""
        return 1 / math.sqrt(self.crosstalk) if self.crosstalk else math.inf

    def predict_reading(self, distance: Array) -> Array:
        """What the module reads at these distances, m, without noise and steps; any shape."""
        r = self._uncorrected(distance)
        return np.asarray(self.offset + self.scale * r / (1 + self.crosstalk * r * r))

    def distance(self, raw: Array) -> Array:
        """The distances of these readings, m, any shape.

        0 for a reading below the curve: the target touches. NaN for NaN, and for a reading beyond the curve's maximum.
        """
        r = _distance(raw, self.offset, 1 / self.scale, 4 * self.crosstalk)
        return self.correct(r) if self.corrections else r

    def gain(self, distance: Array) -> Array:
        """By how much an error of a reading changes the distance, at these distances within the reach; any shape."""
        r = self._uncorrected(distance)
        light = self.crosstalk * r * r
        gain = np.asarray((1 + light) ** 2 / (self.scale * (1 - light)))
        if not self.corrections:
            return gain
        places, added = np.array(self.corrections).T
        slopes = np.concatenate([[0.0], np.diff(added) / np.diff(places), [0.0]])
        return np.asarray(gain * (1 + slopes[np.searchsorted(places, r)]))

    def std_at(self, distance: Array) -> Array:
        """One standard deviation of a calibrated range at these distances, m, any shape; NaN if the noise is unknown.

        Of its noise, of the curve's residual, and of the way beyond the span.
        """
        return _spread(distance, self.std or math.nan, self.std_slope, self.residual, *self.span)

    def correct(self, r: Array) -> Array:
        """Distances by offset, scale and crosstalk, m, any shape, with the corrections."""
        places, added = np.array(self.corrections).T
        return np.asarray(np.maximum(r + np.interp(r, places, added), 0.0))

    def _uncorrected(self, distance: Array) -> Array:
        """The distances that become these by the corrections."""
        if not self.corrections:
            return np.asarray(distance)
        places, added = np.array(self.corrections).T
        return np.asarray(distance - np.interp(distance, places + added, added))


UNCALIBRATED = ModuleCalibration()
"""Readings are taken as distances; their noise is not known."""


@dataclass(frozen=True)
class Calibration:
    """All modules of a device.

    Attributes:
        serial: the board that was calibrated, hexadecimal in lower case; "" is not known.
        warm_up: s after its start for which the calibration does not hold.
        modules: one for each module, in their order.
        bias_std: one standard deviation of the error that all ranges of a scan share, m; None: not measured.

    Raises:
        Malformed: the warm-up is no finite number.
        InvalidInput: a value is beyond what makes sense.
    """

    serial: str = ""
    warm_up: float = 0.0
    modules: tuple[ModuleCalibration, ...] = (UNCALIBRATED,)
    bias_std: float | None = None

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[0-9a-fA-F]{0,64}", self.serial):
            raise InvalidInput(
                f"serial is {self.serial[:80]!r}.", "Give the board's serial number in hexadecimal, or an empty one."
            )
        warm_up = _finite(self.warm_up, "warm_up")
        if not 0 <= warm_up <= MAX_WARM_UP:
            raise InvalidInput(f"warm_up is {warm_up:g} s.", f"Need 0 to {MAX_WARM_UP:g} s.")
        if not 1 <= len(self.modules) <= MAX_MODULES:
            raise InvalidInput(f"There are {len(self.modules)} modules.", f"Need 1 to {MAX_MODULES}.")
        if self.bias_std is not None and not 0 <= _finite(self.bias_std, "bias_std") <= MAX_BIAS:
            raise InvalidInput(f"bias_std is {self.bias_std:g} m.", f"Need 0 to {MAX_BIAS:g} m.")
        for name, value in {
            "serial": self.serial.lower(),
            "warm_up": warm_up,
            "modules": tuple(self.modules),
        }.items():
            object.__setattr__(self, name, value)

    def distance(self, raw: Array) -> Array:
        """Readings (f, k) of the k modules to distances (f, k), both m; see `ModuleCalibration.distance`."""
        offset, per_scale, four_crosstalk = self._curves
        ranges = _distance(raw, offset, per_scale, four_crosstalk)
        for k, module in self._corrected:
            ranges[:, k] = module.correct(ranges[:, k])
        return ranges

    def std_at(self, distance: Array) -> Array:
        """One standard deviation (f, k), m, of calibrated ranges (f, k), m; NaN where the range or the noise is."""
        return _spread(distance, *self._spreads)

    def beyond(self, distance: Array) -> NDArray[np.bool_]:
        """(f, k), whether calibrated ranges (f, k), m, lie beyond the span by more than noise explains."""
        std, slope, _, start, end = self._spreads
        margin = _MARGIN * np.nan_to_num(std + slope * distance)
        return np.asarray((distance < start - margin) | (distance > end + margin))

    @cached_property
    def noise_known(self) -> bool:
        """Whether that of every module is."""
        return all(module.std for module in self.modules)

    @cached_property
    def _curves(self) -> Array:
        return np.array([(m.offset, 1 / m.scale, 4 * m.crosstalk) for m in self.modules]).T

    @cached_property
    def _corrected(self) -> list[tuple[int, ModuleCalibration]]:
        return [(k, module) for k, module in enumerate(self.modules) if module.corrections]

    @cached_property
    def _spreads(self) -> Array:
        return np.array([(m.std or math.nan, m.std_slope, m.residual, *m.span) for m in self.modules]).T
