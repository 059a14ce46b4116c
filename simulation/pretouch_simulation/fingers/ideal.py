"""`ideal`: the paper's fingertip: a thin beam with 1.5 mm of noise."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch.tof import Sensor
from pretouch_simulation.fingers.status import Status
from pretouch_simulation.world import World


@dataclass(frozen=True)
class ThinBeam:
    """A `Finger` whose module measures along one ray."""

    sensor: Sensor = field(default_factory=Sensor)

    def begin_scan(self, count: int, rng: np.random.Generator) -> _Measurements:
        """See `Finger.begin_scan`."""
        return _Measurements(self.sensor, rng.normal(0.0, self.sensor.range_std, count))


@dataclass(frozen=True)
class _Measurements:
    sensor: Sensor
    noise: Array

    def take(self, world: World, base_T_module: Array, first: int = 0) -> tuple[Array, NDArray[np.int64]]:
        """See `Measurements.take`."""
        noise = self.noise[first : first + len(base_T_module)]
        ranges = world.cast(base_T_module[:, :3, 3], base_T_module[:, :3, 2]) + noise
        status = np.full(len(ranges), Status.OK, dtype=np.int64)
        status[ranges < self.sensor.range_min] = Status.RANGE_UNDERFLOW
        status[ranges > self.sensor.range_max] = Status.NO_TARGET
        return np.where(status == Status.OK, ranges, np.nan), status


def draw(rng: np.random.Generator) -> ThinBeam:
    """The fingertip; nothing about it varies."""
    return ThinBeam()
