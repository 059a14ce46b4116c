"""The one range, without noise, that a module reads from everything in its field of view.

A surface patch answers with response * reflectance * cos(incidence) / r^2, a Lambertian target. Near patches count for
more, by exp(-(r - nearest) / L): modules trigger on the leading edge of the returned pulse. Of what is left the module
reports the mean, or it looks for a peak of the histogram of paths, the first or the strongest one. The reading is
scaled so that a perpendicular wall at `CALIBRATED_AT` reads its distance.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch_simulation.fingers.spot import Spot
from pretouch_simulation.world import TABLE, World

CALIBRATED_AT = 0.05
"""m: from here a perpendicular wall reads its distance, and returns the signal 1."""
_LEAST_PATH = 1e-3
_BIN = 0.001
_BINS = 400
_CENTRES = (np.arange(_BINS) + 0.5) * _BIN
_FIRST_PEAK = 0.3
"""A peak counts as the first one if it is at least this share of the highest."""
_SHIFTS = 5


class Estimator(StrEnum):
    """Which range stands for the whole view."""

    MEAN = "mean"
    FIRST_PEAK = "first peak"
    STRONGEST_PEAK = "strongest peak"


@dataclass(frozen=True)
class Reflectances:
    """Reflectances, relative to the wall that the module was calibrated on.

    Attributes:
        table: of the table.
        bodies: of body 0, 1, ...; repeated if there are more bodies.
    """

    table: float = 1.0
    bodies: tuple[float, ...] = (1.0,)

    @staticmethod
    def draw(darkest: float, rng: np.random.Generator) -> Reflectances:
        """Log-uniform from `darkest` to 1, for the table and for eight bodies."""
        table, *bodies = np.exp(rng.uniform(np.log(darkest), 0.0, 9)).tolist()
        return Reflectances(table, tuple(bodies))

    def of(self, bodies: NDArray[np.int64]) -> Array:
        """(n,) for the bodies (n,) that `World.trace` says were met."""
        cycle = np.array(self.bodies)
        return np.where(bodies == TABLE, self.table, cycle[np.maximum(bodies, 0) % len(cycle)])


@dataclass(frozen=True)
class ConeResponse:
    """A module without noise.

    Attributes:
        nearness: m, L above; inf: near and far parts count alike.
        pulse: m, standard deviation of the pulse that smooths the histogram; peaks closer than this merge.
    """

    spot: Spot
    nearness: float
    estimator: Estimator = Estimator.MEAN
    pulse: float = 0.006

    @cached_property
    def _bundle(self) -> tuple[Array, Array]:
        return self.spot.rays()

    @cached_property
    def _wall(self) -> tuple[float, float]:
        """What a perpendicular wall at `CALIBRATED_AT` reads and returns, uncalibrated."""
        rays, response = self._bundle
        path = CALIBRATED_AT / rays[:, 2]
        signal = response * rays[:, 2] / path**2
        return float(self._range(path[None], signal[None])[0]), float(signal.sum())

    @cached_property
    def _smoothing(self) -> Array:
        """(_BINS, _BINS): what each bin of the histogram adds to the smoothed one."""
        return np.asarray(np.exp(-0.5 * ((_CENTRES[:, None] - _CENTRES) / self.pulse) ** 2), dtype=np.float64)

    def read(self, world: World, base_T_module: Array, reflectances: Reflectances) -> tuple[Array, Array]:
        """What is seen from module poses (n, 4, 4).

        Returns:
            Ranges (n,), m, inf without a return; signal (n,), 1 for the wall of the calibration.
        """
        rays, response = self._bundle
        n, k = len(base_T_module), len(rays)
        directions = np.einsum("nij,kj->nki", base_T_module[:, :3, :3], rays).reshape(-1, 3)
        hits = world.trace(np.repeat(base_T_module[:, :3, 3], k, axis=0), directions)
        incidence = np.abs(np.einsum("ij,ij->i", hits.normals, directions)) * reflectances.of(hits.bodies)
        path = np.maximum(hits.distances, _LEAST_PATH).reshape(n, k)
        signal = response * incidence.reshape(n, k) / path**2
        wall_range, wall_signal = self._wall
        return self._range(path, signal) * (CALIBRATED_AT / wall_range), signal.sum(axis=1) / wall_signal

    def _range(self, path: Array, signal: Array) -> Array:
        """(n,), m, of paths (n, k), inf = nothing met, and signals (n, k), 0 there; inf where there is no signal."""
        met = signal > 0
        finite = np.where(met, path, 0.0)
        nearest = np.where(met, path, np.inf).min(axis=1, keepdims=True)
        seen = met.any(axis=1)
        beyond = np.where(met, path - np.where(np.isfinite(nearest), nearest, 0.0), 0.0)
        weight = signal * np.exp(-beyond / self.nearness)
        if self.estimator is not Estimator.MEAN:
            peak = self._peak(finite, weight)
            for _ in range(_SHIFTS):
                peak = _mean(finite, weight * np.exp(-0.5 * ((finite - peak[:, None]) / self.pulse) ** 2))
            return np.where(seen, peak, np.inf)
        return np.where(seen, _mean(finite, weight), np.inf)

    def _peak(self, path: Array, weight: Array) -> Array:
        """(n,), m: the first or the highest peak of each row's histogram smoothed by the pulse, to the nearest bin."""
        n = len(path)
        bins = np.minimum((path / _BIN).astype(np.int64), _BINS - 1)
        histogram = np.zeros((n, _BINS))
        np.add.at(histogram, (np.arange(n)[:, None], bins), weight)
        density = histogram @ self._smoothing
        if self.estimator is Estimator.STRONGEST_PEAK:
            return np.asarray(_CENTRES[density.argmax(axis=1)])
        before = np.pad(density, ((0, 0), (1, 0)))[:, :-1]
        after = np.pad(density, ((0, 0), (0, 1)))[:, 1:]
        peaks = (density >= before) & (density > after) & (density >= _FIRST_PEAK * density.max(axis=1, keepdims=True))
        return np.asarray(_CENTRES[peaks.argmax(axis=1)])


def _mean(path: Array, weight: Array) -> Array:
    total = weight.sum(axis=1)
    return np.asarray((weight * path).sum(axis=1) / np.where(total > 0, total, 1.0), dtype=np.float64)
