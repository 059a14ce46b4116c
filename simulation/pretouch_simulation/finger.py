"""The simulated fingertip: what its time-of-flight modules report in a world.

Two models. `ideal` is the paper's: a thin beam with 1.5 mm of noise. `vl6180x` is the real module (`vl6180x.py`).
Both report the VL6180X's own status codes.
"""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pretouch.geometry import Array
from pretouch.tof import STATUS_OK, Sensor
from pretouch_simulation import vl6180x
from pretouch_simulation.world import World

_IDEAL = Sensor()


class FingerModel(StrEnum):
    """Which fingertip is simulated."""

    IDEAL = "ideal"
    VL6180X = "vl6180x"


def sensor_of(model: FingerModel | str) -> Sensor:
    """What a client states of the model when it creates a session; one module at the tip."""
    return _IDEAL if FingerModel(model) is FingerModel.IDEAL else vl6180x.SENSOR


def measure(
    world: World, base_T_module: ArrayLike, model: FingerModel | str, rng: np.random.Generator
) -> tuple[Array, NDArray[np.int64]]:
    """One measurement at each of the modules' poses (n, 4, 4), the beam along the module's z.

    Returns:
        Ranges (n,), m along the beam, NaN where the module gave none; status codes (n,), 0 is good.
    """
    poses = np.asarray(base_T_module, dtype=np.float64).reshape(-1, 4, 4)
    if FingerModel(model) is FingerModel.VL6180X:
        return vl6180x.measure(world, poses, rng)
    noise = rng.normal(0.0, _IDEAL.range_std, len(poses))
    return _thin_beam(world, poses, noise)


def _thin_beam(world: World, poses: Array, noise: Array) -> tuple[Array, NDArray[np.int64]]:
    ranges = world.cast(poses[:, :3, 3], poses[:, :3, 2]) + noise
    status = np.full(len(ranges), STATUS_OK, dtype=np.int64)
    status[ranges < _IDEAL.range_min] = vl6180x.Status.RANGE_UNDERFLOW
    status[ranges > _IDEAL.range_max] = vl6180x.Status.NO_TARGET
    return np.where(status == STATUS_OK, ranges, np.nan), status
