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
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field

import numpy as np

from pretouch.errors import InvalidInput, Malformed
from pretouch.geometry import Array

MAX_MODULES = 256
MAX_WARM_UP = 86_400.0
"""s, a day."""
_LIMITS = {
    "offset": (-0.1, 0.1, "m"),
    "scale": (0.5, 2.0, "m of reading for a m of distance"),
    "crosstalk": (0.0, 1e4, "1/m^2"),
    "std": (1e-6, 0.1, "m"),
    "std_slope": (0.0, 1.0, "m of noise for a m of distance"),
}


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


@dataclass(frozen=True)
class ModuleCalibration:
    """One module. The defaults are an uncalibrated module, whose readings are taken as distances.

    Attributes:
        offset: m that it reads at distance 0.
        scale: m read for a m of distance, without crosstalk; 0.5 to 2.
        crosstalk: k of the module's docstring, 1/m^2.
        std: one standard deviation of the noise of a calibrated range at distance 0, m.
        std_slope: by how much that grows with each m of distance.

    Raises:
        Malformed: a value is no finite number.
        InvalidInput: a value is beyond what a module can be.
    """

    offset: float = 0.0
    scale: float = 1.0
    crosstalk: float = 0.0
    std: float = 0.0015
    std_slope: float = 0.0

    def __post_init__(self) -> None:
        for name, (least, most, unit) in _LIMITS.items():
            value = _finite(getattr(self, name), name)
            object.__setattr__(self, name, value)
            if not least <= value <= most:
                raise InvalidInput(f"{name} is {value:g}.", f"Need {least:g} to {most:g} {unit}.")

    @property
    def reach(self) -> float:
        """m: the farthest distance that can be measured; infinite without crosstalk."""
        return 1 / math.sqrt(self.crosstalk) if self.crosstalk else math.inf

    def predict_reading(self, distance: Array) -> Array:
        """What the module reads at these distances, m, without noise and steps; any shape."""
        return np.asarray(self.offset + self.scale * distance / (1 + self.crosstalk * distance * distance))

    def distance(self, raw: Array) -> Array:
        """The distances of these readings, m, any shape.

        0 for a reading below the offset: the target touches. NaN for NaN, and for a reading beyond the curve's maximum.
        """
        return _distance(raw, self.offset, 1 / self.scale, 4 * self.crosstalk)

    def gain(self, distance: Array) -> Array:
        """By how much an error of a reading changes the distance, at these distances within the reach; any shape."""
        light = self.crosstalk * distance * distance
        return np.asarray((1 + light) ** 2 / (self.scale * (1 - light)))

    def std_at(self, distance: Array) -> Array:
        """One standard deviation of a calibrated range's noise at these distances, m, any shape."""
        return np.asarray(self.std + self.std_slope * distance)


UNCALIBRATED = ModuleCalibration()
"""Readings are taken as distances, with the noise of the better sensors of this kind."""


@dataclass(frozen=True)
class Calibration:
    """All modules of a device.

    Attributes:
        serial: the board that was calibrated, hexadecimal in lower case; "" is not known.
        warm_up: s after its start for which the calibration does not hold.
        modules: one for each module, in their order.

    Raises:
        Malformed: the warm-up is no finite number.
        InvalidInput: a value is beyond what makes sense.
    """

    serial: str = ""
    warm_up: float = 0.0
    modules: tuple[ModuleCalibration, ...] = (UNCALIBRATED,)
    _columns: Array = field(init=False, repr=False, compare=False)

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
        columns = [(m.offset, 1 / m.scale, 4 * m.crosstalk, m.std, m.std_slope) for m in self.modules]
        for name, value in {
            "serial": self.serial.lower(),
            "warm_up": warm_up,
            "modules": tuple(self.modules),
            "_columns": np.ascontiguousarray(np.array(columns).T),
        }.items():
            object.__setattr__(self, name, value)

    def distance(self, raw: Array) -> Array:
        """Readings (f, k) of the k modules to distances (f, k), both m; see `ModuleCalibration.distance`."""
        offset, per_scale, four_crosstalk, _, _ = self._columns
        return _distance(raw, offset, per_scale, four_crosstalk)

    def std_at(self, distance: Array) -> Array:
        """One standard deviation (f, k), m, of calibrated ranges (f, k), m; NaN where the range is."""
        return np.asarray(self._columns[3] + self._columns[4] * distance)
