"""The examples' robot programs before fake arms with the vendors' own signatures: units, conventions, order."""

from __future__ import annotations

import importlib
import subprocess
import sys
import time
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from helpers.arm_sdks import START, Checked, FakeFranka, FakeGateway, FakeUr, FakeXArm, check_call

from pretouch.errors import Unavailable
from pretouch.geometry import Array, Pose
from pretouch.session import GatewaySpan, ScanPlan, Skipped
from pretouch.trajectory import Trajectory

TILTED = Pose.from_rotation_vector([0.1, 0.0, 0.0], [0, 0, 0]).rotation @ np.diag([1.0, -1.0, -1.0])
"""The beam down, 0.1 rad from vertical."""


def plan() -> ScanPlan:
    """4 cm along x, in 0.4 s."""
    turned = TILTED @ Pose.from_rotation_vector([0, 0, 0.7], [0, 0, 0]).rotation
    poses = [Pose.of(turned, [x, 0.05, 0.06]).matrix for x in (0.50, 0.52, 0.54)]
    return ScanPlan("scan-1", "line-1", None, Trajectory(np.array([0.0, 0.2, 0.4]), np.stack(poses)), 1.0)


def ur(monkeypatch: pytest.MonkeyPatch) -> tuple[ModuleType, FakeUr]:
    control = pytest.importorskip("rtde_control").RTDEControlInterface
    receive = pytest.importorskip("rtde_receive").RTDEReceiveInterface
    example, arm = importlib.import_module("examples.ur"), FakeUr()
    monkeypatch.setattr(example, "RTDEControlInterface", _constructor(control, arm))
    monkeypatch.setattr(example, "RTDEReceiveInterface", _constructor(receive, arm))
    return example, arm


def xarm(monkeypatch: pytest.MonkeyPatch) -> tuple[ModuleType, FakeXArm]:
    api = pytest.importorskip("xarm.wrapper").XArmAPI
    example, arm = importlib.import_module("examples.ufactory_xarm"), FakeXArm()
    monkeypatch.setattr(example, "XArmAPI", _constructor(api, arm))
    return example, arm


def franka(monkeypatch: pytest.MonkeyPatch) -> tuple[ModuleType, FakeFranka]:
    franky = pytest.importorskip("franky")
    example = importlib.import_module("examples.franka")
    arm = FakeFranka(franky.ControlException, lambda matrix: franky.RobotPose(franky.Affine(matrix)))
    assert all(hasattr(franky.Robot, name) for name in ("current_pose", "relative_dynamics_factor"))
    motion = franky.CartesianMotion(franky.Affine())
    for name, arguments in {"recover_from_errors": {}, "poll_motion": {}, "move": {"asynchronous": True}}.items():
        check_call(getattr(franky.Robot, name), *([motion] if arguments else []), **arguments)
    monkeypatch.setattr(example, "FrankyRobot", lambda host: arm)
    return example, arm


def _constructor(real: type, arm: Any) -> Any:
    def construct(*args: Any, **kwargs: Any) -> Checked:
        check_call(real.__init__, *args, **kwargs)
        return Checked(real, arm)

    return construct


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pretouch.client.guard.SILENCE", 30.0)


ARMS = pytest.mark.parametrize("arm_of", [ur, xarm, franka])


def tip_offset(example: ModuleType) -> Array:
    offset: Pose = example.EE_T_TIP if hasattr(example, "EE_T_TIP") else example.FLANGE_T_TIP
    return offset.matrix


@ARMS
def test_the_tip_follows_the_plan_and_the_gateway_is_told_where_it_is(
    monkeypatch: pytest.MonkeyPatch, arm_of: Any
) -> None:
    example, arm = arm_of(monkeypatch)
    gateway, path = FakeGateway(), plan().path
    before = time.time()
    span = example.scan(example.Robot("192.0.2.1"), gateway, plan())
    assert isinstance(span, GatewaySpan)
    assert span.device == gateway.device == "finger"
    assert before <= span.start < span.end <= time.time()
    assert arm.motions[:2] == ["move", "move"]
    assert "servo" in arm.motions
    times, tips = np.array([t for t, _ in gateway.told]), np.array([pose for _, pose in gateway.told])
    assert (np.diff(times) > 0).all()
    assert tips[0, 2, 3] > 0.15  # on the way down
    tips = tips[tips[:, 2, 3] < 0.06 + 1e-6]
    np.testing.assert_allclose(
        tips[:, :3, :3], np.broadcast_to(path.base_T_tip[0, :3, :3], (len(tips), 3, 3)), atol=1e-6
    )
    np.testing.assert_allclose(tips[:, 1:3, 3], np.broadcast_to([0.05, 0.06], (len(tips), 2)), atol=1e-6)
    assert (np.diff(tips[:, 0, 3]) > -1e-9).all()
    assert tips[0, 0, 3] < 0.53
    assert 0.53 < tips[-1, 0, 3] <= 0.54 + 1e-9
    tip = arm.flange @ tip_offset(example)
    assert tip[2, 3] == pytest.approx(example.TRAVEL_HEIGHT)
    arm_to_last = tip[:3, 3] - path.base_T_tip[-1, :3, 3]
    np.testing.assert_allclose(np.cross(arm_to_last, tip[:3, 2]), 0, atol=1e-2)


@ARMS
def test_the_tip_is_lifted_over_what_the_plan_did_not_expect(monkeypatch: pytest.MonkeyPatch, arm_of: Any) -> None:
    example, _ = arm_of(monkeypatch)
    gateway = FakeGateway(ground=0.055)
    assert isinstance(example.scan(example.Robot("192.0.2.1"), gateway, plan()), GatewaySpan)
    tips = np.array([pose for _, pose in gateway.told])
    assert tips[:, 2, 3].min() > gateway.ground
    assert tips[-1, 2, 3] > gateway.ground + 0.02
    assert tips[-1, 0, 3] > 0.53


@ARMS
def test_a_finger_that_is_not_heard_stops_the_scan_with_its_tip_lifted(
    monkeypatch: pytest.MonkeyPatch, arm_of: Any
) -> None:
    class Deaf(FakeGateway):
        def StreamPoints(self, requests: Any) -> Any:
            for _ in super().StreamPoints(requests):
                yield from ()

    example, arm = arm_of(monkeypatch)
    monkeypatch.setattr("pretouch.client.guard.SILENCE", 0.1)
    with pytest.raises(Unavailable, match="not heard"):
        example.scan(example.Robot("192.0.2.1"), Deaf(), plan())
    assert (arm.flange @ tip_offset(example))[2, 3] == pytest.approx(example.TRAVEL_HEIGHT)


@ARMS
def test_what_the_arm_cannot_reach_is_skipped(monkeypatch: pytest.MonkeyPatch, arm_of: Any) -> None:
    example, arm = arm_of(monkeypatch)
    arm.reach = 0.45
    gateway = FakeGateway()
    assert isinstance(example.scan(example.Robot("192.0.2.1"), gateway, plan()), Skipped)
    assert gateway.told == []
    assert "servo" not in arm.motions


def test_a_franka_that_stops_on_its_way_lifts_its_tip(monkeypatch: pytest.MonkeyPatch) -> None:
    example, arm = franka(monkeypatch)
    arm.reach = 0.53
    assert isinstance(example.scan(example.Robot("192.0.2.1"), FakeGateway(), plan()), Skipped)
    assert not arm.stopped
    assert (arm.flange @ tip_offset(example))[2, 3] == pytest.approx(example.TRAVEL_HEIGHT)


def test_an_xarm_is_asked_for_the_flange_poses_of_the_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    example, arm = xarm(monkeypatch)
    example.scan(example.Robot("192.0.2.1"), FakeGateway(), plan())
    flanges = plan().path.base_T_tip @ np.linalg.inv(tip_offset(example))
    np.testing.assert_allclose(arm.asked[2:5], flanges, atol=1e-9)
    assert arm.motions.count("move") == 3


@pytest.mark.parametrize(
    ("name", "sdk"), [("ur", "rtde_control"), ("ufactory_xarm", "xarm.wrapper"), ("franka", "franky")]
)
def test_a_copied_file_finds_the_sdk_and_not_itself(name: str, sdk: str, tmp_path: Path) -> None:
    pytest.importorskip(sdk)
    source = Path(__file__).resolve().parents[2] / "examples" / f"{name}.py"
    copy = tmp_path / source.name
    copy.write_text(source.read_text().replace("    main()\n", "    print(Robot)\n"))
    done = subprocess.run([sys.executable, copy], capture_output=True, text=True, timeout=120, check=False)
    assert "__main__.Robot" in done.stdout, done.stderr


def test_a_call_that_the_sdk_would_refuse_is_refused() -> None:
    api = pytest.importorskip("xarm.wrapper").XArmAPI
    with pytest.raises(TypeError, match="is_radians"):
        check_call(api.set_position_aa, [0.0] * 6, is_radians=True)
    control = pytest.importorskip("rtde_control").RTDEControlInterface
    with pytest.raises(TypeError, match="arg5"):
        check_call(control.servoL, [0.0] * 6, 0.0, 0.0, 0.002, 0.1)
    with pytest.raises(TypeError, match="number"):
        check_call(control.setTcp, START.tolist())
