"""A pose, a unit or an order of axes that users get wrong is named, and a right one is never a warning."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from helpers.scenes import Box, View, World, looking
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pretouch_orchestrator.perception.placement_check import check_placement

from pretouch.camera import DepthImage
from pretouch.geometry import Plane, Pose
from pretouch.scene import Scene
from pretouch.session import SessionRequest
from pretouch.session_warning import SessionWarning

LEVEL = Plane(np.array([0.0, 0.0, 1.0]), 0.0)
ORIGIN = (0.0, 0.0, 0.0)
WORLD = World((Box.standing((0.08, 0.06, 0.05)),))
SCENES = [
    WORLD.scene(View(looking((0.02, -0.03, 0.02), 0.8, down, azimuth))) for down in (35, 50, 80) for azimuth in (0, 70)
]

bases = st.builds(
    lambda yaw, x, y, z: Pose.from_rotation_vector((0.0, 0.0, yaw), (x, y, z)),
    *(st.floats(-np.pi, np.pi), st.floats(0.3, 0.8), st.floats(-0.5, 0.5), st.floats(-0.3, 0.3)),
)
"""Where the scenes' worlds are in base."""
scenes = st.sampled_from(SCENES)


def warnings_of(scene: Scene, base_T_camera: Pose, table: Plane | None = None) -> list[SessionWarning]:
    """Of the scene's view with another pose of its camera, and with a table that is given."""
    seen = LEVEL.moved(scene.base_T_camera.inverse())
    placed = replace(scene, base_T_camera=base_T_camera, table=table or seen.moved(base_T_camera))
    warnings = check_placement(SessionRequest(scene.camera, base_T_camera, table=table), placed, seen)
    assert all(warning.detail.endswith(".") and warning.remedy.endswith(".") for warning in warnings)
    return warnings


@settings(max_examples=60, deadline=None)
@given(scenes, bases, st.tuples(*[st.floats(-0.12, 0.12)] * 2))
def test_no_right_pose_is_a_warning(scene: Scene, base: Pose, tilt: tuple[float, float]) -> None:
    leaning = Pose.from_rotation_vector((*tilt, 0.0), ORIGIN)
    assert warnings_of(scene, leaning @ base @ scene.base_T_camera) == []


MISTAKES: dict[str, Callable[[Pose], Pose]] = {
    "inverted": Pose.inverse,
    "OpenGL": lambda pose: pose @ Pose.of(np.diag([1.0, -1.0, -1.0]), ORIGIN),
    "link frame": lambda pose: pose @ Pose.of([[0, -1, 0], [0, 0, -1], [1, 0, 0]], ORIGIN),
    "w, x, y, z": lambda pose: Pose.from_quaternion(pose.translation, np.roll(pose.quaternion, 1)),
    "millimetres": lambda pose: Pose.of(pose.rotation, 1000 * pose.translation),
}


@pytest.mark.parametrize("name", MISTAKES)
@settings(max_examples=40, deadline=None)
@given(scenes, bases)
def test_a_wrong_pose_is_named_wherever_it_shows(name: str, scene: Scene, base: Pose) -> None:
    wrong = MISTAKES[name](base @ scene.base_T_camera)
    up = wrong.rotate(LEVEL.moved(scene.base_T_camera.inverse()).normal)
    assume(up[2] < np.cos(np.radians(13)) or name == "millimetres")
    (warning,) = warnings_of(scene, wrong)
    assert name in warning.detail


def test_a_base_on_a_ceiling_is_a_warning_until_the_table_is_given() -> None:
    ceiling = Pose.from_rotation_vector((np.pi, 0.0, 0.0), (0.4, 0.1, 0.9))
    camera = ceiling @ SCENES[0].base_T_camera
    assert "ceiling" in warnings_of(SCENES[0], camera)[0].remedy
    assert warnings_of(SCENES[0], camera, table=LEVEL.moved(ceiling)) == []


def test_a_camera_far_away_and_a_base_far_away_are_said_apart() -> None:
    far = WORLD.scene(View(looking((0.0, 0.0, 0.02), 2.3, 45.0)))
    assert [warning.code for warning in warnings_of(far, far.base_T_camera)] == ["camera-far"]
    away = Pose.of(np.eye(3), (40.0, 30.0, 0.0)) @ SCENES[0].base_T_camera
    (warning,) = warnings_of(SCENES[0], away)
    assert warning.code == "object-far"
    assert "50." in warning.detail


def test_depth_in_another_unit_is_named_with_likelier_scales() -> None:
    scene = SCENES[0]
    table = LEVEL.moved(scene.base_T_camera.inverse())
    seen = Plane(table.normal, 10 * table.offset)
    wrong = replace(scene, depth=DepthImage(10 * scene.depth.metres, 0.001), table=seen.moved(scene.base_T_camera))
    (warning,) = check_placement(SessionRequest(scene.camera, scene.base_T_camera), wrong, seen)
    assert warning.code == "depth-scale"
    assert "m with 0.0001" in warning.detail
