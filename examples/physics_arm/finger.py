"""The fingertip's range sensor: one ray of the engine's, with errors of its own."""

from __future__ import annotations

import numpy as np

from examples.physics_arm.rays import cast
from examples.physics_arm.world import World
from pretouch.client.reflex import RANGE_UNDERFLOW
from pretouch.tof import STATUS_OK, Sensor

SENSOR = Sensor(range_min=0.01, range_max=0.10, range_std=0.002, rate=30.0)
"""What pretouch is told of it."""
_STD, _STD_SLOPE = 0.0008, 0.01  # m, and m for each metre of range
_OFFSET_STD = 0.0005  # m, of an error that all ranges of a run share
_STEP = 0.001  # m
_LOST, _WRONG = 0.02, 0.005
_NO_TARGET = 7
"""Status code of a range that is lost or too long."""


class Finger:
    """The sensor of one run."""

    def __init__(self, world: World, random: np.random.Generator) -> None:
        self._world, self._random = world, random
        self._offset = _OFFSET_STD * random.standard_normal()

    def measure(self) -> tuple[float, int]:
        """The range along the beam now, m, and its status code; NaN where there is none."""
        pose, random = self._world.base_T_tip(), self._random
        true = float(cast(self._world, pose[:3, 3], pose[None, :3, 2], ignored_body="finger")[0][0])
        if random.random() < _WRONG:
            return float(random.uniform(SENSOR.range_min, SENSOR.range_max)), STATUS_OK
        noisy = true + self._offset + (_STD + _STD_SLOPE * true) * random.standard_normal()
        seen = SENSOR.range_min <= noisy <= SENSOR.range_max and random.random() > _LOST
        if seen:
            return round(noisy / _STEP) * _STEP, STATUS_OK
        return float("nan"), RANGE_UNDERFLOW if noisy < SENSOR.range_min else _NO_TARGET
