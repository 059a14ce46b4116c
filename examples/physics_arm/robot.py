"""The robot program's arm: follows a planned scan with its joints, and samples range and tip pose on the way."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import closing
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from examples.physics_arm.finger import SENSOR, Finger
from examples.physics_arm.kinematics import collides, follow, raise_tip
from examples.physics_arm.world import World
from pretouch.client import Reflex, ScanPiece
from pretouch.session import ScanPlan, Skipped
from pretouch.tof import RangeSamples

Array = NDArray[np.float64]

_HOVER = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])
"""rad: high above the table; travels that would touch something go this way."""
_TRAVEL_HEIGHT = 0.30  # m above the table, between scans
_APPROACH = 2.5  # s from there down along the beam to the first waypoint, and from the last one back up
_TRAVEL = 0.6  # rad/s of the joint that has farthest to go
_PIECE = 0.25  # s between the pieces in which samples are yielded
_RATE = 25.0  # poses per second that inverse kinematics is asked for


@dataclass
class Robot:
    """The arm with its finger.

    Attributes:
        touches: motions during which the arm touched something.
        skipped: scans that it could not make.
    """

    world: World
    finger: Finger
    touches: int = 0
    skipped: int = 0

    def scan(self, plan: ScanPlan) -> Generator[ScanPiece, None, None]:
        """Makes the planned scan and yields its samples every _PIECE seconds, or says that the arm cannot.

        Closed, it leaves the path upwards.
        """
        times, poses, start, end = _add_approach(plan)
        joints = follow(self.world, times, poses)
        if joints is None or not self._travel(joints[0]):
            self.skipped += 1
            yield Skipped()
            return
        waiting: list[_Sample] = []
        try:
            with closing(self._play_guarded(times, joints)) as samples:
                for sample in samples:
                    if start <= sample.t <= end:
                        waiting.append(sample)
                    if waiting and (sample.t - waiting[0].t >= _PIECE or sample.t > end):
                        yield _collect(waiting)
                        waiting = []
        except GeneratorExit:
            self._rise()
            raise

    def _rise(self) -> None:
        """Lifts the tip along the beam to _TRAVEL_HEIGHT; it stays where that is out of reach."""
        poses = _rise_from(self.world.base_T_tip())
        times = np.arange(len(poses)) / _RATE
        joints = follow(self.world, times, poses, np.array(self.world.data.qpos))
        if joints is not None:
            self._play(times, joints)

    def _travel(self, goal: Array) -> bool:
        """Moves the joints to `goal`, directly or by way of _HOVER; False, without a move, if both would touch."""
        for stops in ([goal], [_HOVER, goal]):
            corners = np.stack([self.world.data.qpos, *stops])
            shares = np.linspace(0, len(stops), 40 * len(stops))
            path = np.stack([np.interp(shares, range(len(corners)), column) for column in corners.T], axis=1)
            if not any(collides(self.world, joints) for joints in path):
                times = np.cumsum([0, *(np.abs(np.diff(corners, axis=0)).max(axis=1) / _TRAVEL)])
                self._play(times + np.arange(len(times)) * 1e-3, corners)
                return True
        return False

    def _play(self, times: Array, joints: Array) -> None:
        """Lets the motors follow `joints` (n, 7) at `times` (n,), s."""
        begun, touched = self.world.data.time, False
        while (now := self.world.data.time - begun) < times[-1]:
            touched |= self._step(_interpolate(times, joints, now))
        self.touches += touched

    def _play_guarded(self, times: Array, joints: Array) -> Generator[_Sample, None, None]:
        """As `_play`, with the tip lifted by a reflex, which sees a sample at the sensor's rate; the samples."""
        begun, touched, interval, count = self.world.data.time, False, 1.0 / SENSOR.rate, 0
        reflex, lifted, offset = Reflex(), joints[0], np.zeros_like(joints[0])
        try:
            while (now := self.world.data.time - begun) < times[-1]:
                touched |= self._step(_interpolate(times, joints, now) + offset)
                if now >= count * interval:
                    count += 1
                    sample = _Sample(now, self.world.base_T_tip(), *self.finger.measure())
                    yield sample
                    reflex = reflex.update(sample.range, sample.status, interval)
                    planned = _interpolate(times, joints, now)
                    raised = raise_tip(self.world, planned, reflex) if reflex.lift > 0 else planned
                    lifted = lifted if raised is None else raised  # out of reach: it waits where it is
                    offset = lifted - planned
        finally:
            self.touches += touched

    def _step(self, joints: Array) -> bool:
        """One step of the engine towards `joints` (7,), rad; whether something touches."""
        self.world.data.ctrl[:] = joints
        mujoco.mj_step(self.world.model, self.world.data)
        return self.world.is_touching()


class _Sample(NamedTuple):
    t: float
    base_T_tip: Array
    range: float
    status: int


def _collect(samples: list[_Sample]) -> RangeSamples:
    t, tips, ranges, status = (np.array(column) for column in zip(*samples, strict=True))
    return RangeSamples(t, tips, ranges, status, np.zeros(len(t), int))


def _interpolate(times: Array, joints: Array, now: float) -> Array:
    return np.array([np.interp(now, times, column) for column in joints.T])


def _add_approach(plan: ScanPlan) -> tuple[Array, Array, float, float]:
    """From above the first waypoint to above the last: times (n,), s, tip poses (n, 4, 4), and when the scan is on."""
    path = plan.path.sampled(_RATE)
    times, poses = path.t - path.t[0], path.base_T_tip
    down, up = _rise_from(poses[0])[::-1], _rise_from(poses[-1])
    start = len(down) / _RATE
    end = start + times[-1]
    before, after = np.arange(len(down)) / _RATE, end + np.arange(1, len(up) + 1) / _RATE
    return np.concatenate([before, start + times, after]), np.concatenate([down, poses, up]), start, end


def _rise_from(base_T_tip: Array) -> Array:
    """Tip poses (n, 4, 4), 1 / _RATE s apart, from just above a pose up along the beam to _TRAVEL_HEIGHT."""
    steps = int(_APPROACH * _RATE)
    beam, shares = base_T_tip[:3, 2], np.arange(1, steps + 1) / steps
    poses = np.repeat(base_T_tip[None], steps, axis=0)
    poses[:, :3, 3] += (shares * (_TRAVEL_HEIGHT - base_T_tip[2, 3]) / beam[2])[:, None] * beam
    return poses
