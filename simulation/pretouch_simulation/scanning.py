"""A finger moved exactly along a planned path, its samples taken straight from the world."""

from __future__ import annotations

import numpy as np

from pretouch.tof import RangeSamples, Sensor
from pretouch.trajectory import Trajectory
from pretouch_simulation.finger import FingerModel, measure
from pretouch_simulation.world import World


def scan_along(
    world: World, path: Trajectory, sensor: Sensor, model: FingerModel, rng: np.random.Generator
) -> RangeSamples:
    """What a fingertip of `model` reports along `path` in `world`: every module of `sensor`, at the sensor's rate."""
    tips = path.sampled(sensor.rate)
    modules = np.stack([pose.matrix for pose in sensor.tip_T_module])
    n, m = len(tips.t), len(modules)
    base_T_module = np.einsum("nij,mjk->nmik", tips.base_T_tip, modules).reshape(-1, 4, 4)
    ranges, status = measure(world, base_T_module, model, rng)
    return RangeSamples(
        t=np.repeat(tips.t, m),
        base_T_tip=np.repeat(tips.base_T_tip, m, axis=0),
        range=ranges,
        status=status,
        module=np.tile(np.arange(m), n),
    )
