"""The robot program's arm: follows a planned scan with its joints, and samples range and tip pose on the way."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from examples.physics_arm.finger import SENSOR, Finger
from examples.physics_arm.kinematics import collides, follow
from examples.physics_arm.world import World
from pretouch.session import ScanPlan, Skipped
from pretouch.tof import RangeSamples

Array = NDArray[np.float64]

_HOVER = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])
"""rad: high above the table; travels that would touch something go this way."""
_TRAVEL_HEIGHT = 0.30  # m above the table, between scans
_APPROACH = 2.5  # s from there down along the beam to the first waypoint, and from the last one back up
_TRAVEL = 0.6  # rad/s of the joint that has farthest to go
_RATE = 25.0  # poses per second that inverse kinematics is asked for


@dataclass
class Robot:
    """The arm with its finger.

    Attributes:
        touches: motions during which the arm touched something.
    """

    world: World
    finger: Finger
    touches: int = 0

    def scan(self, plan: ScanPlan) -> RangeSamples | Skipped:
        """Makes the planned scan, or says that the arm cannot."""
        times, poses, start, end = _add_approach(plan)
        joints = follow(self.world, times, poses)
        if joints is None or not self._travel(joints[0]):
            return Skipped()
        samples = self._play(times, joints, 1.0 / SENSOR.rate)
        kept = [sample for sample in samples if start <= sample[0] <= end]
        t, tips, ranges = (np.array(column) for column in zip(*kept, strict=True))
        return RangeSamples(t, tips, ranges, np.zeros(len(t), int), np.zeros(len(t), int))

    def _travel(self, goal: Array) -> bool:
        """Moves the joints to `goal`, directly or by way of _HOVER; False, without a move, if both would touch."""
        for stops in ([goal], [_HOVER, goal]):
            corners = np.stack([self.world.data.qpos, *stops])
            shares = np.linspace(0, len(stops), 40 * len(stops))
            path = np.stack([np.interp(shares, range(len(corners)), column) for column in corners.T], axis=1)
            if not any(collides(self.world, joints) for joints in path):
                times = np.cumsum([0, *(np.abs(np.diff(corners, axis=0)).max(axis=1) / _TRAVEL)])
                self._play(times + np.arange(len(times)) * 1e-3, corners, np.inf)
                return True
        return False

    def _play(self, times: Array, joints: Array, interval: float) -> list[tuple[float, Array, float]]:
        """Lets the motors follow `joints` (n, 7) at `times` (n,), s; (time, tip pose, range) every `interval` s."""
        model, data = self.world.model, self.world.data
        begun, touched = data.time, False
        samples: list[tuple[float, Array, float]] = []
        while (now := data.time - begun) < times[-1]:
            data.ctrl[:] = [np.interp(now, times, column) for column in joints.T]
            mujoco.mj_step(model, data)
            touched |= self.world.is_touching()
            if now >= len(samples) * interval:
                samples.append((now, self.world.base_T_tip(), self.finger.measure()))
        self.touches += touched
        return samples


def _add_approach(plan: ScanPlan) -> tuple[Array, Array, float, float]:
    """From above the first waypoint to above the last: times (n,), s, tip poses (n, 4, 4), and when the scan is on."""
    path = plan.path.sampled(_RATE)
    times, poses = path.t - path.t[0], path.base_T_tip
    steps = int(_APPROACH * _RATE)
    shares = np.arange(steps, 0, -1) / steps
    down, up = np.repeat(poses[:1], steps, axis=0), np.repeat(poses[-1:], steps, axis=0)
    for leg, share in ((down, shares), (up, shares[::-1])):
        beam = leg[0, :3, 2]
        leg[:, :3, 3] += (share * (_TRAVEL_HEIGHT - leg[0, 2, 3]) / beam[2])[:, None] * beam
    start = steps / _RATE
    end = start + times[-1]
    before, after = np.arange(steps) / _RATE, end + np.arange(1, steps + 1) / _RATE
    return np.concatenate([before, start + times, after]), np.concatenate([down, poses, up]), start, end
