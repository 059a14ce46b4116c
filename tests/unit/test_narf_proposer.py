"""Proposer `narf`: a rectangle about each keypoint by the paper's rule, deterministically."""

import numpy as np
import pytest
from helpers.scenes import KINECT, Box, World
from pretouch_detector.proposals import propose
from pretouch_detector.proposals.narf.rectangles import make_region

from pretouch.camera import Camera, DepthImage
from pretouch.geometry import Plane, Pose
from pretouch.scene import Scene
from pretouch.session import Proposer
from pretouch.tof import Sensor

CAMERA = Camera(500.0, 500.0, 100.0, 80.0)
FACING = np.hstack([np.eye(3), np.zeros((3, 1))]).astype(np.float32)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return World((Box.standing((0.10, 0.07, 0.12), yaw=0.5),)).scene(KINECT, np.random.default_rng(3))


def descriptor(**elements: float) -> np.ndarray:
    values = np.full(36, -0.1, np.float32)
    for name, value in elements.items():
        values[int(name[1:])] = value
    return values


@pytest.mark.parametrize(
    ("elements", "theta", "aspect", "confidence"),
    [
        ({"b9": 0.4, "b18": 0.2}, 0.0, 2.0, 0.6),  # falls away to the right, and downwards
        ({"b9": 0.4, "b0": 0.3, "b18": 0.1}, 0.0, 4 / 3, 0.7),  # the larger of the two across
        ({"b0": 0.3, "b27": 0.3}, -np.pi / 2, 1.0, 0.6),
        ({"b12": 0.4, "b21": 0.4}, np.radians(30), 1.0, 0.8),
        (
            {"b33": 0.2, "b24": 0.1},
            np.radians(60),
            2.0,
            0.3,
        ),  # the beam to the upper left is the axis to the lower right
        ({"b9": 0.4, "b0": 0.01}, 0.0, 3.3, 0.41),
        ({"b9": 0.4}, 0.0, 3.3, 0.3),  # rises on both sides across
        ({"b9": -0.05}, 0.0, 3.3, 0.0),  # a pit
    ],
)
def test_the_rectangle_of_a_descriptor(
    elements: dict[str, float], theta: float, aspect: float, confidence: float
) -> None:
    found = make_region(np.array([80, 100]), descriptor(**elements), FACING, CAMERA, 1200.0)
    rectangle = found.rectangle
    assert (rectangle.x, rectangle.y) == (100.0, 80.0)
    assert rectangle.theta == pytest.approx(theta, abs=1e-6)
    assert rectangle.w * rectangle.h == pytest.approx(1200.0)
    assert rectangle.w / rectangle.h == pytest.approx(aspect, rel=1e-5)
    assert found.confidence == pytest.approx(confidence, abs=1e-6)


def test_the_first_axis_is_turned_as_the_camera_sees_it() -> None:
    tilt = np.radians(60)  # the patch leans back: its downward axis comes towards the camera
    pose = np.zeros((3, 4), np.float32)
    pose[:, :3] = [[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]]
    found = make_region(np.array([80, 100]), descriptor(b14=0.3, b23=0.3), pose, CAMERA, 100.0)
    beam = np.radians(140)
    assert found.rectangle.theta == pytest.approx(np.arctan2(-np.cos(beam) * np.cos(tilt), np.sin(beam)), abs=1e-5)


def test_each_region_is_about_a_keypoint_and_half_the_bounding_rectangle(scene: Scene) -> None:
    regions = propose(scene, Proposer.NARF, Sensor(), 20, 0).regions
    assert 3 <= len(regions) <= 20
    left, top, right, bottom = scene.bounds()
    for found in regions:
        rectangle = found.rectangle
        assert scene.mask[int(rectangle.y), int(rectangle.x)]
        assert rectangle.w * rectangle.h == pytest.approx((right - left) * (bottom - top) / 2)
        assert 0 <= found.confidence <= 1
    assert [r.confidence for r in regions] == sorted((r.confidence for r in regions), reverse=True)
    assert len({(r.rectangle.x, r.rectangle.y) for r in regions}) == len(regions)


def test_nothing_is_left_to_chance_and_a_smaller_count_takes_the_surest(scene: Scene) -> None:
    regions = propose(scene, Proposer.NARF, Sensor(), 200, 0).regions
    assert regions == propose(scene, Proposer.NARF, Sensor(), 200, 1).regions
    assert regions[:2] == propose(scene, Proposer.NARF, Sensor(), 2, 2).regions


def test_the_image_around_the_object_does_not_matter(scene: Scene) -> None:
    view, (u0, v0) = scene.cropped(0.15)
    regions = propose(view, Proposer.NARF, Sensor(), 20, 0).regions
    expected = propose(scene, Proposer.NARF, Sensor(), 20, 0).regions
    assert [r.rectangle.shifted(u0, v0) for r in regions] == [r.rectangle for r in expected]


def test_a_finer_image_gives_the_same_regions_in_its_own_pixels(scene: Scene) -> None:
    depth, mask = (np.repeat(np.repeat(a, 2, 0), 2, 1) for a in (scene.depth.metres, scene.mask))
    c = scene.camera
    fine = Scene(
        DepthImage(depth), Camera(2 * c.fx, 2 * c.fy, 2 * c.cx, 2 * c.cy), scene.base_T_camera, mask, scene.table
    )
    regions = propose(fine, Proposer.NARF, Sensor(), 20, 0).regions
    coarse = propose(scene, Proposer.NARF, Sensor(), 20, 0).regions
    assert [r.confidence for r in regions] == [r.confidence for r in coarse]
    for ours, theirs in zip(regions, coarse, strict=True):
        expected = np.array(theirs.rectangle.as_list()) * (2, 2, 2, 2, 1)
        np.testing.assert_allclose(ours.rectangle.as_list(), expected, rtol=1e-6)


@pytest.mark.parametrize("shape", ["finger-wide", "tiny depths", "a speck in front", "all of it"])
def test_no_image_keeps_the_proposer_long(shape: str) -> None:
    rng = np.random.default_rng(0)
    depth = rng.normal(0.8, 0.0015, (480, 640)).astype(np.float32)
    mask = np.zeros(depth.shape, np.bool_)
    mask[200:280, 280:360] = True
    if shape == "finger-wide":
        mask[:] = False
        mask[240, 300:360] = True
    elif shape == "tiny depths":
        depth *= 0.001
    elif shape == "a speck in front":
        depth[240:242, 300:302] = 0.01
    else:
        mask[:] = True
    camera, table = Camera(525.0, 525.0, 319.5, 239.5), Plane(np.array([0.0, 0.0, 1.0]), 0.0)
    found = propose(Scene(DepthImage(depth), camera, Pose.identity(), mask, table), Proposer.NARF, Sensor(), 20, 0)
    assert all(0 <= region.confidence <= 1 for region in found.regions)


def test_a_plain_sheet_has_no_keypoint_and_so_no_region() -> None:
    mask = np.zeros((120, 160), np.bool_)
    mask[40:80, 60:100] = True
    sheet = Scene(
        DepthImage(np.full(mask.shape, 0.9, np.float32)),
        CAMERA,
        Pose.identity(),
        mask,
        Plane(np.array([0, 0, 1.0]), 0.0),
    )
    assert propose(sheet, Proposer.NARF, Sensor(), 20, 0).regions == []
