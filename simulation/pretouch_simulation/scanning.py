"""A scan by a finger that follows a planned path exactly, its samples computed from the world."""

from __future__ import annotations

import numpy as np

from pretouch.tof import RangeSamples, Sensor
from pretouch.trajectory import Trajectory
from pretouch_simulation.finger import Finger
from pretouch_simulation.world import World


def scan_along(
    world: World, path: Trajectory, sensor: Sensor, finger: Finger, rng: np.random.Generator
) -> RangeSamples:
    """What `finger` reports along `path` in `world`, one call a scan: every module of `sensor`, at its rate."""
    tips = path.sampled(sensor.rate)
    modules = np.stack([pose.matrix for pose in sensor.tip_T_module])
    n, m = len(tips.t), len(modules)
    base_T_module = np.einsum("nij,mjk->nmik", tips.base_T_tip, modules).reshape(-1, 4, 4)
    ranges, status = finger.measure(world, base_T_module, rng)
    return RangeSamples(
        t=np.repeat(tips.t, m),
        base_T_tip=np.repeat(tips.base_T_tip, m, axis=0),
        range=ranges,
        status=status,
        module=np.tile(np.arange(m), n),
    )
