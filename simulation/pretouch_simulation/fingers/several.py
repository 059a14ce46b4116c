"""A fingertip of several modules, each simulated as a fingertip of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pretouch.geometry import Array, Pose
from pretouch.tof import STATUS_OK, Sensor
from pretouch_simulation.finger import Finger, Measurements
from pretouch_simulation.world import World


@dataclass(frozen=True)
class Several:
    """A `Finger` whose module k measures as `fingers[k]`, in turn; each module has its own bias in a scan.

    Attributes:
        sensor: as the client describes it, with the modules' poses.
        fingers: one for each module.
    """

    sensor: Sensor
    fingers: tuple[Finger, ...]

    def begin_scan(self, count: int, rng: np.random.Generator) -> _Measurements:
        """See `Finger.begin_scan`."""
        m = len(self.fingers)
        return _Measurements(
            tuple(finger.begin_scan(len(range(k, count, m)), rng) for k, finger in enumerate(self.fingers))
        )


@dataclass(frozen=True)
class _Measurements:
    modules: tuple[Measurements, ...]

    def take(self, world: World, base_T_module: Array, first: int = 0) -> tuple[Array, NDArray[np.int64]]:
        """See `Measurements.take`."""
        m = len(self.modules)
        ranges = np.full(len(base_T_module), np.nan)
        status = np.full(len(base_T_module), STATUS_OK, dtype=np.int64)
        for k, module in enumerate(self.modules):
            turns = slice((k - first) % m, None, m)
            ranges[turns], status[turns] = module.take(world, base_T_module[turns], len(range(k, first, m)))
        return ranges, status


def side_by_side(fingers: Sequence[Finger], spacing: float) -> Several:
    """Modules in a row along the tip's x, `spacing` m apart, beams parallel, all described as the first one."""
    m = len(fingers)
    places = [Pose.of(np.eye(3), [spacing * (k - (m - 1) / 2), 0.0, 0.0]) for k in range(m)]
    return Several(replace(fingers[0].sensor, tip_T_module=tuple(places)), tuple(fingers))
