"""The simulated depth camera follows the geometry, with the noise of the published model."""

import numpy as np
import pytest
from pretouch_simulation.depth_cameras import kinect
from pretouch_simulation.depth_cameras.kinect import Kinect
from pretouch_simulation.objects import box
from pretouch_simulation.protocol import CAMERA, look_at
from pretouch_simulation.world import NOTHING, TABLE, Body, World

from pretouch.camera import Camera, kinect_depth_std
from pretouch.geometry import Plane, Pose

FLOOR = Plane(np.array([0.0, 0.0, 1.0]), 0.0)
LOOKING_DOWN = np.diag([1.0, -1.0, -1.0])


@pytest.mark.parametrize("depth", [0.6, 0.9, 1.5])
def test_the_noise_on_a_wall_is_the_published_one(depth: float) -> None:
    camera = Camera(580.0, 580.0, 79.5, 59.5)
    image = Kinect().render(
        World([], FLOOR), camera, Pose.of(LOOKING_DOWN, [0, 0, depth]), np.random.default_rng(0), (120, 160)
    )
    assert (image.depth.metres > 0).all()
    assert image.depth.metres.mean() == pytest.approx(depth, abs=2e-4)
    assert image.depth.metres.std() == pytest.approx(float(kinect_depth_std(depth)), rel=0.06)


def test_depth_comes_in_steps_of_an_eighth_of_a_pixel() -> None:
    image = Kinect().render(
        World([], FLOOR), CAMERA, Pose.of(LOOKING_DOWN, [0, 0, 1.0]), np.random.default_rng(0), (48, 64)
    )
    steps = kinect.BASELINE * kinect.FOCAL / image.depth.metres.astype(float) * 8
    assert np.abs(steps - np.rint(steps)).max() < 1e-3
    assert len(np.unique(np.rint(steps))) > 3


def test_labels_are_what_rays_meet_and_there_is_a_shadow_left_of_an_object() -> None:
    world = World([Body(box(0.1, 0.1, 0.2), Pose.identity())], FLOOR)
    image = Kinect().render(world, CAMERA, Pose.of(LOOKING_DOWN, [0, 0, 1.0]), np.random.default_rng(0))
    assert set(np.unique(image.bodies)) == {0, TABLE}
    v, u = np.nonzero(image.bodies == 0)
    assert u.max() - u.min() == pytest.approx(0.1 / 0.8 * 525, abs=1.5)
    assert v.max() - v.min() == pytest.approx(0.1 / 0.8 * 525, abs=1.5)
    rows = image.depth.metres[210:270]
    left_edge, shadow_end = (319.5 + 525 * x for x in (-0.05 / 0.8, -0.05 - (0.075 + 0.05) * 0.2 / 0.8))
    dark = (rows == 0).mean(axis=0)
    reach = dark.sum()
    assert left_edge - shadow_end - 6 < reach < left_edge - shadow_end
    columns = np.nonzero(dark > 0.5)[0]
    assert shadow_end < columns.min() <= columns.max() < left_edge
    assert (rows[:, u.max() + 6 :] > 0).all()


def test_the_edges_of_an_object_wander_by_about_a_pixel() -> None:
    world = World([Body(box(0.2, 0.2, 0.1), Pose.identity())], FLOOR)
    image = Kinect().render(world, CAMERA, Pose.of(LOOKING_DOWN, [0, 0, 0.9]), np.random.default_rng(1))
    seen = (image.depth.metres > 0) & (image.depth.metres < 0.85)
    differs = seen != (image.bodies == 0)
    right = np.nonzero(image.bodies[240] == 0)[0].max()
    assert 0.1 < differs[180:300, right - 1 : right + 2].mean() < 0.6
    assert not differs[180:300, right + 6 :].any()


def test_a_camera_that_looks_at_nothing_has_no_depth() -> None:
    image = Kinect().render(
        World([], FLOOR), CAMERA, Pose.of(np.eye(3), [0, 0, 1.0]), np.random.default_rng(0), (20, 20)
    )
    assert not image.depth.metres.any()
    assert (image.bodies == NOTHING).all()


def test_the_same_seed_renders_the_same_image() -> None:
    world = World([Body(box(), Pose.identity())], FLOOR)
    view = look_at(np.zeros(3), 0.9, 0.8)
    first, again = (Kinect().render(world, CAMERA, view, np.random.default_rng(5)).depth.metres for _ in range(2))
    np.testing.assert_array_equal(first, again)
