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


def line(x: float, z: float = 0.10) -> ScanPlan:
    """6 cm along y at 5 cm/s over x, the beam down from a height of z."""
    poses = [Pose.of(DOWN, [x, y, z]).matrix for y in (0.0, 0.06)]
    return ScanPlan("scan-1", "region-1", Trajectory(np.array([0.0, 1.2]), np.stack(poses)))


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
    assert isinstance(Robot(scene, Finger(scene, np.random.default_rng(0))).scan(plan), Skipped)
    np.testing.assert_array_equal(scene.data.qpos, before)


def test_samples_are_of_the_surface_below_the_tip() -> None:
    scene = world()
    samples = Robot(scene, Finger(scene, np.random.default_rng(0))).scan(line(0.3, z=0.05))
    assert isinstance(samples, RangeSamples)
    assert len(samples) == pytest.approx(36, abs=2)
    heights = samples.base_T_tip[:, 2, 3] - samples.range
    assert abs(float(np.nanmedian(heights))) < 0.002
    assert float(np.abs(samples.base_T_tip[:, 2, 3] - 0.05).max()) < 0.003


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
