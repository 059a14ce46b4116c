"""Samples that cannot be of the planned scan are refused, odd ones are a warning, and robots as they are pass."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.scenes import Box, World
from pretouch_orchestrator.perception.scan_check import check_samples

from pretouch.errors import InvalidInput
from pretouch.geometry import Pose, rotation_from_quaternion
from pretouch.session import ScanPlan
from pretouch.tof import RangeSamples, Sensor
from pretouch.trajectory import Trajectory

WORLD = World((Box.standing((0.08, 0.06, 0.05)),))
SCENE, SENSOR = WORLD.scene(), Sensor()
TURN = Pose.from_rotation_vector((0.1, 0.0, 0.7), (0, 0, 0)).rotation @ np.diag([1.0, -1.0, -1.0])
"""A planned beam that leans by 6 degrees."""
TIPS = np.stack([Pose.of(TURN, place).matrix for place in ((-0.06, 0.0, 0.1), (0.0, 0.01, 0.1), (0.06, 0.0, 0.09))])
PLAN = ScanPlan("scan-3", "line-1", None, Trajectory(np.array([0.0, 1.2, 2.4]), TIPS), 0.9)
GOOD = WORLD.scanned(PLAN.path, SENSOR)


def codes(samples: RangeSamples, sensor: Sensor = SENSOR) -> list[str]:
    warnings = check_samples(samples, PLAN, SCENE, sensor)
    assert all(warning.detail.startswith("In scan-3: The tip") and warning.remedy for warning in warnings)
    return [warning.code for warning in warnings]


def turned(rotation: np.ndarray) -> RangeSamples:
    poses = GOOD.base_T_tip.copy()
    poses[:, :3, :3] = poses[:, :3, :3] @ rotation
    return replace(GOOD, base_T_tip=poses)


def lifted(by: float) -> RangeSamples:
    poses = GOOD.base_T_tip.copy()
    poses[:, 2, 3] += by
    return replace(GOOD, base_T_tip=poses)


def about_z(degrees: float) -> np.ndarray:
    return Pose.from_rotation_vector((0, 0, np.radians(degrees)), (0, 0, 0)).rotation


PAUSED = np.where(np.arange(len(GOOD)) > len(GOOD) // 2, 900.0, 0.0)
CODES = np.where(np.arange(len(GOOD)) % 2, 65.535, 8190.0)


@pytest.mark.parametrize(
    "samples",
    [
        GOOD,
        GOOD.select(slice(0, 1)),
        GOOD.select(slice(0, 0)),
        lifted(0.06),
        turned(about_z(140.0)),
        replace(GOOD, t=20 * GOOD.t),
        replace(GOOD, t=GOOD.t + 1.7e9),
        replace(GOOD, t=GOOD.t + PAUSED),
        replace(GOOD, t=np.zeros(len(GOOD))),
        replace(GOOD, range=CODES),
        replace(GOOD, range=np.where(np.isfinite(GOOD.range), 1000 * GOOD.range, np.nan), status=GOOD.status + 1),
    ],
    ids=["good", "one", "none", "lifted", "turned", "slow", "clock", "paused", "no times", "codes", "bad status"],
)
def test_robots_as_they_are_pass(samples: RangeSamples) -> None:
    assert codes(samples) == []


@pytest.mark.parametrize(
    ("samples", "message"),
    [
        (replace(GOOD, range=1000 * GOOD.range), "look like millimetres"),
        (replace(GOOD, t=1e3 * GOOD.t), "Read in milliseconds it would be 0.05"),
        (replace(GOOD, t=1e6 * GOOD.t), "microseconds"),
        (replace(GOOD, t=1e-3 * GOOD.t), r"moves at 5[01]"),
        (lifted(3.0), "3 m from the planned path"),
        (turned(np.diag([1.0, -1.0, -1.0])), "points away"),
    ],
    ids=["mm", "ms", "us", "ks", "far", "backwards"],
)
def test_what_cannot_be_is_refused_as_a_whole_and_in_pieces(samples: RangeSamples, message: str) -> None:
    for piece in (samples, samples.select(slice(20, 40))):
        with pytest.raises(InvalidInput, match=message) as caught:
            check_samples(piece, PLAN, SCENE, SENSOR)
        assert caught.value.remedy


def test_odd_tips_are_warnings() -> None:
    assert codes(lifted(0.2)) == ["base-t-tip-off-path"]
    assert codes(turned(Pose.from_rotation_vector((0.7, 0, 0), (0, 0, 0)).rotation)) == ["tip-tilted"]
    reordered = rotation_from_quaternion(np.roll(Pose.of(TURN, (0, 0, 0)).quaternion, 1))
    assert codes(turned(TURN.T @ reordered)) == ["tip-wxyz"]


def test_a_turn_about_the_beam_matters_to_modules_beside_it() -> None:
    beside = Sensor(tip_T_module=(Pose.identity(), Pose.of(np.eye(3), (0.01, 0.0, 0.0))))
    assert codes(turned(about_z(140.0)), beside) == ["tip-turned"]
    assert codes(GOOD, beside) == []
