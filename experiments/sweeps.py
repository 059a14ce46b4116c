"""Simulated sweeps over a step, by fingers whose response to it no fit knows.

The fingers are those of `pretouch_simulation.fingers`: cones of Gaussian or flat response whose range is a mean, the
first or the strongest peak of a histogram, with shot noise, steps, a bias that changes from pass to pass, a curve that
bends, misses and outliers. To each a mount and a latency are drawn.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from pretouch_sensor_gateway.calibration.sweep_fit import Sweep
from pretouch_simulation.finger import measure_scan
from pretouch_simulation.fingers.cone_finger import ConeFinger
from pretouch_simulation.objects import box
from pretouch_simulation.world import Body, World

from pretouch.geometry import Array, Plane, Pose, rotation_from_vector

RATE, SPEED = 30.0, 0.03
HEIGHT = 0.02
"""m of the step."""
_REACH = 0.05
"""m to either side of the edge."""
_TILTS = np.radians([15.0, 30.0])
_DOWN = rotation_from_vector([np.pi, 0.0, 0.0])


@dataclass(frozen=True)
class Truth:
    """What was drawn: the module's true pose, its beam included, and its latency, s."""

    tip_T_module: Pose
    latency: float


def draw_truth(finger: ConeFinger, rng: np.random.Generator) -> tuple[Truth, Pose]:
    """The truth with the response's own axis as the beam, and the pose that places the finger's rays."""
    mount = Pose.of(rotation_from_vector([*rng.normal(0, np.radians(2.0), 2), 0.0]), [*rng.normal(0, 0.003, 2), 0.0])
    beam = mount @ Pose.of(rotation_from_vector([*finger.response.spot.boresight, 0.0]), np.zeros(3))
    return Truth(beam, float(rng.uniform(-0.01, 0.04))), mount


def make_world() -> World:
    """A table and a flat block, whose edge is the base's y axis, its top beyond at x < 0."""
    return World(
        [Body(box(0.3, 0.6, HEIGHT), Pose.of(np.eye(3), [-0.15, 0.0, 0.0]))], Plane(np.array([0.0, 0.0, 1.0]), 0.0)
    )


def _passes() -> Iterator[tuple[Array, Array, Array]]:
    """Rotation, start and end of the tip in each motion: across the edge, turned and from two heights, and tilted."""
    for k in range(4):
        turned = _DOWN @ rotation_from_vector([0.0, 0.0, k * np.pi / 2])
        for n, z in enumerate((0.048, 0.07, 0.09)):
            y = 0.05 * ((k + n) % 3 - 1)
            ends = np.array([-_REACH, y, z]), np.array([_REACH, y, z])
            yield turned, ends[(k + n) % 2], ends[(k + n + 1) % 2]
    for k, axis in enumerate(([1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0])):
        for n, tilt in enumerate(_TILTS):
            tilted = _DOWN @ rotation_from_vector(tilt * np.array(axis))
            ends = np.array([0.08, 0.0, 0.035]), np.array([0.08, 0.0, 0.075])
            yield tilted, ends[(k + n) % 2], ends[(k + n + 1) % 2]


def fly(finger: ConeFinger, truth: Truth, mount: Pose, rng: np.random.Generator) -> Sweep:
    """The ranges of all motions, each with its own bias, at times that are late by the latency."""
    world = make_world()
    times, poses, ranges = [], [], []
    start = 0.0
    for rotation, a, b in _passes():
        seconds = float(np.linalg.norm(b - a)) / SPEED
        t = np.arange(0.0, seconds, 1 / RATE)

        def place(at: Array, rotation: Array = rotation, a: Array = a, b: Array = b, seconds: float = seconds) -> Array:
            pose = np.tile(np.eye(4), (len(at), 1, 1))
            pose[:, :3, :3] = rotation
            pose[:, :3, 3] = a + (at / seconds)[:, None] * (b - a)
            return pose

        measured, _ = measure_scan(finger, world, place(t - truth.latency) @ mount.matrix, rng)
        times.append(start + t)
        poses.append(place(t))
        ranges.append(measured)
        start += seconds + 1.0
    return Sweep(np.concatenate(times), np.concatenate(poses), np.concatenate(ranges))
