"""The arm in a physics engine: its inverse kinematics, its camera, and a session against all four services."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="needs mujoco-core: pip install 'pretouch[examples]'")

from pretouch_simulation.services import Services

from examples.physics_arm.camera import INTRINSICS, photograph
from examples.physics_arm.finger import Finger
from examples.physics_arm.kinematics import follow
from examples.physics_arm.robot import Robot
from examples.physics_arm.run import run
from examples.physics_arm.truth import Truth
from examples.physics_arm.world import World
from pretouch.client import RestClient
from pretouch.geometry import Array, Pose
from pretouch.session import ScanPlan, Skipped, State, Tolerance
from pretouch.tof import RangeSamples
from pretouch.trajectory import Trajectory

pytestmark = pytest.mark.timeout(600)
DOWN = np.diag([1.0, -1.0, -1.0])


def world() -> World:
    return World.of("hammer", np.random.default_rng(0))


def as_plan(path: Trajectory) -> ScanPlan:
    return ScanPlan("scan-1", "line-1", None, path, 1.0)


def line(x: float, z: float = 0.10) -> ScanPlan:
    """6 cm along y at 5 cm/s over x, the beam down from a height of z."""
    poses = [Pose.of(DOWN, [x, y, z]).matrix for y in (0.0, 0.06)]
    return as_plan(Trajectory(np.array([0.0, 1.2]), np.stack(poses)))


def scanned(robot: Robot, plan: ScanPlan) -> RangeSamples:
    pieces = list(robot.scan(plan))
    assert all(isinstance(piece, RangeSamples) for piece in pieces)
    return RangeSamples.concatenate([piece for piece in pieces if isinstance(piece, RangeSamples)])


def test_the_arm_follows_a_path_within_its_limits() -> None:
    scene, path = world(), line(0.5).path.sampled(10)
    joints = follow(scene, path.t, path.base_T_tip)
    assert joints is not None
    low, high = scene.model.jnt_range.T
    assert ((joints >= low) & (joints <= high)).all()
    reached = np.stack([_tip_at(scene, angles) for angles in joints])
    np.testing.assert_allclose(reached[:, :3, 2:], path.base_T_tip[:, :3, 2:], atol=2e-3)
    np.testing.assert_allclose(reached[:, :3, 0], np.broadcast_to(reached[0, :3, 0], (len(reached), 3)), atol=2e-3)


def _tip_at(scene: World, joints: Array) -> Array:
    import mujoco

    scene.data.qpos[:] = joints
    mujoco.mj_forward(scene.model, scene.data)
    return scene.base_T_tip()


@pytest.mark.parametrize("plan", [line(1.1), line(0.5, z=-0.05)], ids=["out of reach", "in the table"])
def test_what_the_arm_cannot_reach_is_skipped(plan: ScanPlan) -> None:
    scene = world()
    before = np.array(scene.data.qpos)
    (piece,) = Robot(scene, Finger(scene, np.random.default_rng(0))).scan(plan)
    assert isinstance(piece, Skipped)
    np.testing.assert_array_equal(scene.data.qpos, before)


def test_samples_are_of_the_surface_below_the_tip() -> None:
    scene = world()
    samples = scanned(Robot(scene, Finger(scene, np.random.default_rng(0))), line(0.3, z=0.05))
    assert len(samples) == pytest.approx(36, abs=2)
    heights = samples.base_T_tip[:, 2, 3] - samples.range
    assert abs(float(np.nanmedian(heights))) < 0.002
    assert float(np.abs(samples.base_T_tip[:, 2, 3] - 0.05).max()) < 0.003


def test_an_arm_that_is_stopped_leaves_the_path_upwards_and_scans_again() -> None:
    scene = world()
    robot = Robot(scene, Finger(scene, np.random.default_rng(0)))
    flight = robot.scan(line(0.3, z=0.05))
    first = next(flight)
    flight.close()
    assert isinstance(first, RangeSamples)
    assert first.t[-1] - first.t[0] < 0.3
    tip = scene.base_T_tip()
    np.testing.assert_allclose(tip[:2, 3], first.base_T_tip[-1, :2, 3], atol=0.02)
    assert tip[2, 3] == pytest.approx(0.30, abs=0.01)
    assert len(scanned(robot, line(0.3, z=0.05))) == pytest.approx(36, abs=2)
    assert (robot.touches, robot.skipped) == (0, 0)


def test_the_arms_reflex_keeps_it_off_an_object_that_the_plan_does_not_know() -> None:
    scene = World.of("stapler", np.random.default_rng(0))
    x, y, _ = scene.data.body("object").xpos
    along = scene.data.body("object").xmat.reshape(3, 3)[:, 0]
    poses = [Pose.of(DOWN, [x + s * along[0], y + s * along[1], 0.02]).matrix for s in (-0.03, 0.04)]
    robot = Robot(scene, Finger(scene, np.random.default_rng(0)))
    samples = scanned(robot, as_plan(Trajectory(np.array([0.0, 1.4]), np.stack(poses))))
    assert robot.touches == 0
    assert samples.base_T_tip[:, 2, 3].min() > 0.045
    assert len(samples) == pytest.approx(42, abs=2)


def test_the_camera_sees_the_table_at_its_height_and_the_truth_is_no_error() -> None:
    scene = world()
    view = photograph(scene, np.random.default_rng(1))
    points = view.base_T_camera.apply(INTRINSICS.back_project_image(view.depth * 0.0005))
    heights = points[..., 2][view.depth > 0]
    assert abs(float(np.median(heights[np.abs(heights) < 0.01]))) < 0.001
    truth = Truth.hidden(view, np.random.default_rng(2))
    assert truth.error(truth.base_T_correction) < 1e-12
    assert 0.002 < truth.error(Pose.identity()) < 0.08


def test_a_session_over_rest_finds_a_better_pose() -> None:
    with Services() as services, RestClient(services.rest, timeout=120) as client:
        result = run(client, "stapler", 0, Tolerance(0.008))
    assert result.state in (State.CONVERGED, State.EXHAUSTED)
    assert 1 <= result.scans <= 10
    assert result.error < 0.5 * result.initial_error
    assert result.covered
