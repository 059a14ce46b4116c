"""A scan by a finger that follows a planned path exactly, its samples computed from the world."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pretouch.client import Reflex, add_descent
from pretouch.geometry import Array
from pretouch.tof import RangeSamples, Sensor
from pretouch.trajectory import Trajectory
from pretouch_simulation.finger import Finger
from pretouch_simulation.robot_motion import PIECE
from pretouch_simulation.world import World


def scan_along(
    world: World,
    path: Trajectory,
    sensor: Sensor,
    finger: Finger,
    rng: np.random.Generator,
    reflex: Reflex | None = None,
) -> RangeSamples:
    """What `finger` reports along `path` in `world`, one call a scan: every module of `sensor`, at its rate.

    Args:
        reflex: of a robot that guards its scans; the samples carry the tip's poses as it lifted them.
    """
    if reflex is not None:
        return fly_guarded(world, path, sensor, finger, rng, reflex)[1]
    tips = path.sampled(sensor.rate)
    base_T_module = _place_modules(tips.base_T_tip, sensor)
    return _collect_samples(
        tips.t, tips.base_T_tip, *finger.begin_scan(len(base_T_module), rng).take(world, base_T_module)
    )


def cut_pieces(samples: RangeSamples) -> list[RangeSamples]:
    """The samples in pieces of PIECE seconds: as a robot tells them that yields them while it moves."""
    ends = np.arange(samples.t[0] + PIECE, samples.t[-1], PIECE) if len(samples) else np.zeros(0)
    bounds = [0, *np.searchsorted(samples.t, ends).tolist(), len(samples)]
    cut = [samples.select(slice(begin, end)) for begin, end in pairwise(bounds)]
    return [piece for piece in cut if len(piece)]


def fly_guarded(
    world: World, path: Trajectory, sensor: Sensor, finger: Finger, rng: np.random.Generator, reflex: Reflex
) -> tuple[Array, RangeSamples]:
    """A scan whose tip `reflex` lifts on the way down to the path and along it, by what `finger` reports.

    Returns:
        Tip poses (k, 4, 4) of the descent, and the samples along the path, both as flown.
    """
    planned = add_descent(path).sampled(sensor.rate)
    n, m = len(planned.t), len(sensor.tip_T_module)
    measurements = finger.begin_scan(n * m, rng)
    flown, ranges, status = np.empty((n, 4, 4)), np.empty((n, m)), np.empty((n, m), dtype=np.int64)
    for k, base_T_tip in enumerate(planned.base_T_tip):
        flown[k] = reflex.raise_tip(base_T_tip)
        ranges[k], status[k] = measurements.take(world, _place_modules(flown[k : k + 1], sensor), k * m)
        reflex = reflex.update(ranges[k], status[k], 1 / sensor.rate)
    start = int(np.searchsorted(planned.t, path.t[0] - 1e-9))
    return flown[:start], _collect_samples(
        planned.t[start:], flown[start:], ranges[start:].ravel(), status[start:].ravel()
    )


def _place_modules(base_T_tip: Array, sensor: Sensor) -> Array:
    """The poses (n * m, 4, 4) of the m modules at tip poses (n, 4, 4)."""
    modules = np.stack([pose.matrix for pose in sensor.tip_T_module])
    return np.asarray(np.einsum("nij,mjk->nmik", base_T_tip, modules).reshape(-1, 4, 4), dtype=np.float64)


def _collect_samples(t: Array, base_T_tip: Array, ranges: Array, status: NDArray[np.int64]) -> RangeSamples:
    """Samples at times (n,) and tip poses (n, 4, 4) from ranges and status codes (n * m,) of m modules in turn."""
    m = len(ranges) // len(t)
    return RangeSamples(
        np.repeat(t, m), np.repeat(base_T_tip, m, axis=0), ranges, status, np.tile(np.arange(m), len(t))
    )
