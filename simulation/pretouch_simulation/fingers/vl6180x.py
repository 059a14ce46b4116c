"""`vl6180x`: a model of ST's VL6180X proximity module: a cone instead of a beam, steps, bias, misses and outliers.

Sources. Where nothing better is known, a number is an assumption, and says so.

- Cone: 25 deg in full, ST's usual statement for this family of modules. Within it the response falls to half at the
  edge as a Gaussian (assumption: the field of view is the full width at half maximum, as ST's AN5894 defines one of
  its fields of view). A surface patch answers with cos(incidence) / r^2, a Lambertian target.
- Range: the signal's mean path over the cone, scaled so that a perpendicular wall reads its distance.
- 1 mm steps, 0 to "above 10 cm", status codes: datasheet.
- Noise: 0.7 mm at contact growing linearly to 2 mm at 10 cm (assumption, within the 2 mm that the datasheet allows).
- Bias: 2 mm at 10 cm, growing with the square of the range (assumption: what an offset calibration at close range
  leaves).
- Too little light: below a quarter of what a perpendicular wall at 10 cm returns, no convergence (assumption).
- Below 1 cm: half of the measurements underflow, the others wander up to 23 mm for a target that stands still (users'
  reports on the module's Arduino library).
- Misses at random, 1 %, and status-0 outliers, 0.3 % (assumption; users report such outliers for the VL53L1X).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch.tof import Sensor
from pretouch_simulation.fingers.status import Status
from pretouch_simulation.world import World

HALF_ANGLE = float(np.radians(12.5))
STEP = 0.001
NOISE_AT_CONTACT = 0.0007
NOISE_AT_MAX = 0.002
BIAS_AT_MAX = 0.002
LEAST_SIGNAL = 0.25
WANDER = 0.023
SNR_MISSES = 0.007
EARLY_MISSES = 0.003
OUTLIERS = 0.003
_RINGS = 4

SENSOR = Sensor(range_std=NOISE_AT_MAX, beam_half_angle=HALF_ANGLE)
"""The client's description of the module; its noise is the model's largest."""


def _bundle() -> tuple[Array, Array]:
    """Unit rays (k, 3) in the module's frame, evenly over the cone, and the response (k,) along each."""
    polar, turn = [0.0], [0.0]
    for ring in range(1, _RINGS + 1):
        count = 6 * ring
        polar += [HALF_ANGLE * ring / (_RINGS + 0.5)] * count
        turn += list(2 * np.pi * (np.arange(count) + 0.5 * (ring % 2)) / count)
    t, p = np.array(polar), np.array(turn)
    rays = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=1)
    return rays, np.exp(-np.log(2.0) * (t / HALF_ANGLE) ** 2)


RAYS, RESPONSE = _bundle()
_ON_WALL = RESPONSE * RAYS[:, 2] ** 3
"""Signal of each ray from a perpendicular wall at 1 m: incidence and distance are those of the ray's own angle."""
_WALL_SIGNAL = float(_ON_WALL.sum())
_CALIBRATION = _WALL_SIGNAL / float((_ON_WALL / RAYS[:, 2]).sum())


def mean_range(world: World, poses: Array) -> tuple[Array, Array]:
    """What a noiseless module sees from poses (n, 4, 4).

    Returns:
        Ranges (n,), m, inf without a return; signal (n,), 1 for a perpendicular wall at 1 m.
    """
    n, k = len(poses), len(RAYS)
    directions = np.einsum("nij,kj->nki", poses[:, :3, :3], RAYS).reshape(-1, 3)
    hits = world.trace(np.repeat(poses[:, :3, 3], k, axis=0), directions)
    incidence = np.abs(np.einsum("ij,ij->i", hits.normals, directions))
    met = np.isfinite(hits.distances)
    path = np.where(met, hits.distances, 1.0).reshape(n, k)
    signal = np.where(met.reshape(n, k), RESPONSE * incidence.reshape(n, k) / np.maximum(path, 1e-4) ** 2, 0.0)
    total = signal.sum(axis=1)
    ranges = np.full(n, np.inf)
    np.divide((signal * path).sum(axis=1) * _CALIBRATION, total, out=ranges, where=total > 0)
    return ranges, total / _WALL_SIGNAL


@dataclass(frozen=True)
class VL6180X:
    """A `Finger` with the real module."""

    sensor: Sensor = SENSOR

    def begin_scan(self, count: int, rng: np.random.Generator) -> _Measurements:
        """See `Finger.begin_scan`."""
        return _Measurements(self.sensor, rng.standard_normal(count), rng.uniform(size=count), rng.uniform(size=count))


@dataclass(frozen=True)
class _Measurements:
    sensor: Sensor
    normal: Array
    chance: Array
    wander: Array

    def take(self, world: World, base_T_module: Array, first: int = 0) -> tuple[Array, NDArray[np.int64]]:
        """See `Measurements.take`."""
        n = len(base_T_module)
        normal, chance, wander = (drawn[first : first + n] for drawn in (self.normal, self.chance, self.wander))
        true, signal = mean_range(world, base_T_module)
        share = np.minimum(true, self.sensor.range_max) / self.sensor.range_max
        noise = (NOISE_AT_CONTACT + (NOISE_AT_MAX - NOISE_AT_CONTACT) * share) * normal
        ranges = true + BIAS_AT_MAX * share**2 + noise

        near = true < self.sensor.range_min
        ranges[near] = np.where(chance < 0.5, 0.0, self.sensor.range_min + wander * (WANDER - self.sensor.range_min))[
            near
        ]
        status = np.zeros(n, dtype=np.int64)
        usable = ~near
        status[usable & (chance < SNR_MISSES + EARLY_MISSES)] = Status.EARLY_CONVERGENCE
        status[usable & (chance < SNR_MISSES)] = Status.SNR
        ranges = np.where(np.isfinite(ranges), np.round(ranges / STEP) / round(1 / STEP), np.inf)
        status[ranges < self.sensor.range_min] = Status.RANGE_UNDERFLOW
        dark = signal < LEAST_SIGNAL / self.sensor.range_max**2
        status[(ranges > self.sensor.range_max) | dark] = Status.NO_TARGET
        outlier = usable & (chance > 1 - OUTLIERS)
        spurious = self.sensor.range_min + wander * (self.sensor.range_max - self.sensor.range_min)
        ranges[outlier] = np.round(spurious[outlier] / STEP) / round(1 / STEP)
        status[outlier] = Status.OK
        return np.where(status == Status.OK, ranges, np.nan), status


def draw(rng: np.random.Generator) -> VL6180X:
    """The fingertip; nothing about it varies."""
    return VL6180X()
