"""Broken fingertips: each is described as a sound sensor and reports something else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch.tof import STATUS_OK, Sensor
from pretouch_simulation.finger import Finger, Measurements
from pretouch_simulation.fingers.several import Several, side_by_side
from pretouch_simulation.fingers.status import Status
from pretouch_simulation.world import World

Break = Callable[[Array, Array], Array]
"""Ranges (n,), m, NaN = none, that a sound finger measured, and random numbers (n,), uniform in [0, 1), to the ranges
that the broken one reports."""


@dataclass(frozen=True)
class Broken:
    """A `Finger` that reports the measurements of `finger` as changed by `fault`, whatever their status was."""

    finger: Finger
    fault: Break

    @property
    def sensor(self) -> Sensor:
        return self.finger.sensor

    def begin_scan(self, count: int, rng: np.random.Generator) -> _Measurements:
        """See `Finger.begin_scan`."""
        return _Measurements(self.finger.begin_scan(count, rng), self.fault, rng.uniform(size=count))


@dataclass(frozen=True)
class _Measurements:
    sound: Measurements
    fault: Break
    uniform: Array

    def take(self, world: World, base_T_module: Array, first: int = 0) -> tuple[Array, NDArray[np.int64]]:
        """See `Measurements.take`; an absent range comes with status 7."""
        measured, _ = self.sound.take(world, base_T_module, first)
        ranges = self.fault(measured, self.uniform[first : first + len(measured)])
        return ranges, np.where(np.isnan(ranges), Status.NO_TARGET, STATUS_OK).astype(np.int64)


def make_stuck_finger(finger: Finger, at: float = 0.03) -> Finger:
    """Always reports `at`, m."""
    return Broken(finger, lambda ranges, _: np.full(len(ranges), at))


def make_dead_finger(finger: Finger) -> Finger:
    """Never reports a range."""
    return Broken(finger, lambda ranges, _: np.full(len(ranges), np.nan))


def make_noise_finger(finger: Finger) -> Finger:
    """Reports ranges that are uniform over the sensor's range, whatever is there."""
    low, high = finger.sensor.range_min, finger.sensor.range_max
    return Broken(finger, lambda _, uniform: low + (high - low) * uniform)


def make_millimetre_finger(finger: Finger) -> Finger:
    """Reports millimetres instead of metres."""
    return Broken(finger, lambda ranges, _: 1000 * ranges)


def make_stuck_module(finger: Finger, at: float = 0.03, modules: int = 6, spacing: float = 0.008) -> Several:
    """A row of modules `spacing` m apart, all as `finger` but for the last, which always reports `at`, m."""
    return side_by_side([*[finger] * (modules - 1), make_stuck_finger(finger, at)], spacing)
