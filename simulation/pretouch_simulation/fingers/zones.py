"""`zones`: a fingertip with one multizone module like ST's VL53L5CX: 8 x 8 zones over a square of 45 deg, 15 Hz.

Sources. Where nothing better is known, a number is an assumption, and says so.

- Field of view, zones, 15 Hz, 2 cm to 4 m: datasheet. Used up to 25 cm here. A zone sees a square of 5.6 deg evenly.
- The module reports distances along its axis; the ranges here are along each zone's beam, as a driver converts them.
- Noise: 4 mm for each zone, 1 mm that all zones of a frame share, 1 mm that all frames of a scan share, and 1 mm that
  each zone keeps from scan to scan (assumption: the datasheet allows 15 mm below 20 cm, without calibration).
- 1 mm steps: datasheet. Misses at random, 1 % (assumption).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pretouch.geometry import Array, Pose, rotation_from_vector
from pretouch.tof import Sensor
from pretouch_simulation.fingers.cone_response import ConeResponse, Reflectances
from pretouch_simulation.fingers.spot import Spot
from pretouch_simulation.fingers.status import Status
from pretouch_simulation.world import World

SIDE = 8
ZONE = float(np.radians(45.0 / SIDE))
"""rad: width of a zone."""
NOISE, FRAME_NOISE, SCAN_BIAS, ZONE_BIAS = 0.004, 0.001, 0.001, 0.001
STEP = 0.001
MISSES = 0.01
_RAYS = 3


@dataclass(frozen=True)
class SquareSpot(Spot):
    """A square field of view with an even response; `half_angle` is that of a side."""

    def rays(self) -> tuple[Array, Array]:
        """See `Spot.rays`: a grid of nine."""
        across = self.half_angle * (2 * np.arange(_RAYS) + 1 - _RAYS) / _RAYS
        x, y = (each.ravel() for each in np.meshgrid(np.tan(across), np.tan(across)))
        rays = np.stack([x, y, np.ones_like(x)], axis=1)
        return rays / np.linalg.norm(rays, axis=1, keepdims=True), np.ones(len(rays))


def _place_zones() -> tuple[Pose, ...]:
    """Poses of the zones in the tip's frame, row by row: all at its origin, x and y turned by whole zones."""
    angles = ZONE * (np.arange(SIDE) - (SIDE - 1) / 2)
    turns = [rotation_from_vector([0.0, x, 0.0]) @ rotation_from_vector([-y, 0.0, 0.0]) for y in angles for x in angles]
    return tuple(Pose.of(turn, np.zeros(3)) for turn in turns)


SENSOR = Sensor(
    range_min=0.02, range_max=0.25, range_std=NOISE, beam_half_angle=ZONE / 2, rate=15.0, tip_T_module=_place_zones()
)


@dataclass(frozen=True)
class MultizoneFinger:
    """A `Finger` with all zones.

    Attributes:
        zone_bias: (64,), m.
    """

    sensor: Sensor
    zone_bias: tuple[float, ...]

    def begin_scan(self, count: int, rng: np.random.Generator) -> _Measurements:
        """See `Finger.begin_scan`."""
        zones = len(self.zone_bias)
        shared = SCAN_BIAS * rng.standard_normal() + FRAME_NOISE * rng.standard_normal(-(-count // zones))
        bias = np.resize(self.zone_bias, count) + np.repeat(shared, zones)[:count]
        return _Measurements(self.sensor, bias + NOISE * rng.standard_normal(count), rng.uniform(size=count) < MISSES)


@dataclass(frozen=True)
class _Measurements:
    sensor: Sensor
    error: Array
    missed: NDArray[np.bool_]

    def take(self, world: World, base_T_module: Array, first: int = 0) -> tuple[Array, NDArray[np.int64]]:
        """See `Measurements.take`."""
        here = slice(first, first + len(base_T_module))
        true, _ = _RESPONSE.read(world, base_T_module, Reflectances())
        ranges = np.where(np.isfinite(true), np.round((true + self.error[here]) / STEP) / round(1 / STEP), np.inf)
        status = np.full(len(ranges), Status.OK, dtype=np.int64)
        status[(true < self.sensor.range_min) | (ranges < self.sensor.range_min)] = Status.RANGE_UNDERFLOW
        status[(ranges > self.sensor.range_max) | self.missed[here]] = Status.NO_TARGET
        return np.where(status == Status.OK, ranges, np.nan), status


_RESPONSE = ConeResponse(SquareSpot(ZONE / 2), nearness=np.inf)


def draw(rng: np.random.Generator) -> MultizoneFinger:
    """A module whose zones' own errors are drawn."""
    return MultizoneFinger(SENSOR, tuple((ZONE_BIAS * rng.standard_normal(SIDE * SIDE)).tolist()))
