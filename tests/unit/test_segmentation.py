"""Object and table are segmented in a depth image, or the error says what the client can send."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.scenes import KINECT, Box, View, World, looking
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from pretouch_orchestrator.perception.segmentation import find_object

from pretouch.camera import Camera, DepthImage
from pretouch.errors import InvalidInput
from pretouch.geometry import Plane, Pose
from pretouch.scene import Scene

BOX = Box.standing((0.09, 0.07, 0.06), (0.02, -0.03), 0.4)
SMALL = Box.standing((0.04, 0.04, 0.04), (-0.02, 0.14))
SHARED = Path(os.environ.get("PRETOUCH_SHARED", Path(__file__).parents[3] / "shared"))


def seen_in(*arguments: Any, **named: Any) -> Scene:
    return find_object(*arguments, **named).scene


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / (a | b).sum())


def tilt(plane: Plane, normal: np.ndarray) -> float:
    return float(np.degrees(np.arccos(min(1.0, plane.normal @ normal))))


@settings(max_examples=15, deadline=None)
@given(
    st.integers(0, 10_000),
    st.floats(30, 75),
    st.floats(-180, 180),
    st.tuples(*[st.floats(-0.2, 0.2)] * 6),
)
def test_the_largest_thing_on_the_table_and_its_table_are_found(
    seed: int, down: float, azimuth: float, turn: tuple[float, ...]
) -> None:
    base_T_world = Pose.from_rotation_vector(turn[:3], turn[3:])
    world = World((BOX, SMALL))
    view = View(looking((0, 0, 0.02), 0.8, down, azimuth), KINECT.camera, KINECT.width, KINECT.height)
    depth, mask = world.depth(view, np.random.default_rng(seed))
    scene = seen_in(depth, view.camera, base_T_world @ view.base_T_camera)
    assert overlap(scene.mask, mask) > 0.85
    table = world.table.moved(base_T_world)
    assert tilt(scene.table, table.normal) < 0.3
    assert abs(scene.table.height(base_T_world.translation)) < 0.002


@pytest.mark.parametrize("roi", [(200, 150, 100, 50), (0, 0, 0, 0), (-5, -5, 10, 10)])
def test_a_roi_without_a_pixel_is_refused(roi: tuple[int, int, int, int]) -> None:
    with pytest.raises(InvalidInput, match="holds no pixel"):
        find_object(DepthImage(np.ones((480, 640), np.float32)), KINECT.camera, KINECT.base_T_camera, roi=roi)


def test_a_wrong_unit_is_named_where_nothing_is_found() -> None:
    far = DepthImage(np.full((480, 640), 9.0, np.float32), scale=0.001)
    with pytest.raises(InvalidInput) as caught:
        find_object(far, KINECT.camera, KINECT.base_T_camera)
    assert "9 m with depth_scale 0.001. It would be 0.90 m with 0.0001" in caught.value.detail


def test_the_roi_tells_which_object_is_meant() -> None:
    world = World((SMALL, BOX))
    depth, mask = world.depth(KINECT)
    v, u = np.nonzero(mask)
    roi = (int(u.min()) - 8, int(v.min()) - 8, int(u.max()) + 8, int(v.max()) + 8)
    scene = seen_in(depth, KINECT.camera, KINECT.base_T_camera, roi=roi)
    assert overlap(scene.mask, mask) > 0.85
    assert tilt(scene.table, world.table.normal) < 0.1


def test_a_neighbour_behind_a_jump_in_depth_is_not_part_of_the_object() -> None:
    world = World((Box.standing((0.08, 0.12, 0.1), (-0.05, 0)), Box.standing((0.05, 0.05, 0.14), (0.1, 0))))
    depth, mask = world.depth(KINECT)
    scene = seen_in(depth, KINECT.camera, KINECT.base_T_camera)
    assert overlap(scene.mask, mask) > 0.85
    behind = seen_in(depth, KINECT.camera, KINECT.base_T_camera, mask=None, roi=(0, 0, 640, int(v_top(mask))))
    assert not (behind.mask & mask).any()


def v_top(mask: np.ndarray) -> int:
    return int(np.nonzero(mask)[0].min())


def test_flying_pixels_belong_to_nothing() -> None:
    world = World((BOX,))
    depth, mask = world.depth(KINECT)
    metres = depth.metres.copy()
    flying = np.random.default_rng(0).random(metres.shape) < 0.02
    metres[flying & ~mask] -= 0.1
    scene = seen_in(DepthImage(metres), KINECT.camera, KINECT.base_T_camera)
    assert overlap(scene.mask, mask) > 0.85


def test_a_wall_behind_the_table_and_a_hand_above_it_are_not_objects() -> None:
    wall = Box.standing((0.05, 3.0, 2.0), (0.45, 0))
    hand = Box.standing((0.15, 0.15, 0.05), (-0.05, -0.2), lift=0.15)
    depth, mask = World((BOX, wall, hand)).depth(KINECT, np.random.default_rng(3))
    scene = seen_in(depth, KINECT.camera, KINECT.base_T_camera, table=Plane(np.array([0, 0, 1.0]), 0.0))
    assert overlap(scene.mask, mask) > 0.85


def test_a_thin_object_is_found_whole() -> None:
    world = World((Box.standing((0.12, 0.09, 0.01)),))
    depth, mask = world.depth(KINECT, np.random.default_rng(1))
    assert overlap(seen_in(depth, KINECT.camera, KINECT.base_T_camera).mask, mask) > 0.85


def test_a_mask_is_kept_within_the_roi_and_where_there_is_depth() -> None:
    depth, mask = World((BOX, SMALL)).depth()
    view = View()
    metres = depth.metres.copy()
    metres[::2] = 0
    scene = seen_in(DepthImage(metres), view.camera, view.base_T_camera, (0, 0, 160, 240), mask)
    wanted = mask.copy()
    wanted[:, 160:] = False
    wanted[::2] = False
    assert not (scene.mask & ~wanted).any()
    assert overlap(scene.mask, wanted) > 0.97  # corners count as flying pixels
    assert tilt(scene.table, np.array([0, 0, 1.0])) < 0.1


def test_a_table_is_found_beside_an_object_that_fills_most_of_the_view() -> None:
    world = World((Box.standing((0.34, 0.3, 0.05)),))
    view = View(looking((0, 0, 0.02), 0.5, 60))
    depth, mask = world.depth(view, np.random.default_rng(2))
    assert mask.mean() > 0.35
    scene = seen_in(depth, view.camera, view.base_T_camera, mask=mask)
    assert tilt(scene.table, world.table.normal) < 0.5
    assert abs(scene.table.offset) < 0.002


def test_a_given_table_is_kept_as_it_is() -> None:
    table = Plane(np.array([0, 0, 1.0]), 0.001)
    depth, _ = World((BOX,)).depth()
    assert seen_in(depth, View().camera, View().base_T_camera, table=table).table is table


EMPTY = np.zeros((240, 320), dtype=bool)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"depth": DepthImage(np.zeros((240, 320)))}, "holds no depth"),
        ({"mask": EMPTY}, "mask is empty"),
        ({"mask": np.ones((10, 10), dtype=bool)}, "mask is"),
        ({"roi": (400, 0, 500, 100)}, "outside the image"),
        ({"mask": np.eye(240, 320, dtype=bool), "roi": (300, 0, 320, 20)}, "empty within the roi"),
        ({"roi": (0, 200, 60, 240)}, "Nothing stands"),
        ({"table": Plane(np.array([0, 0, -1.0]), 0.0)}, "0.59 m below the table that was given"),
        ({"table": Plane(np.array([0, 0, 1.0]), 5.0)}, "4.41 m below the table that was given"),
        ({"depth": DepthImage(np.random.default_rng(0).uniform(0.3, 3, (240, 320)))}, "No table"),
        ({"depth": DepthImage(np.eye(240, 320))}, "No table"),
    ],
)
def test_what_cannot_be_used_is_refused_with_a_remedy(changes: dict, message: str) -> None:
    depth, _ = World((BOX,)).depth()
    arguments = {"depth": depth, "camera": View().camera, "base_T_camera": View().base_T_camera, **changes}
    with pytest.raises(InvalidInput, match=message) as caught:
        find_object(**arguments)
    assert caught.value.remedy


def test_an_empty_table_holds_no_object() -> None:
    depth, mask = World((BOX,)).depth(noise=np.random.default_rng(0))
    metres = depth.metres.copy()
    metres[mask] = 0
    with pytest.raises(InvalidInput, match="Nothing stands"):
        find_object(DepthImage(metres), View().camera, View().base_T_camera)


def test_a_mask_without_depth_is_refused() -> None:
    depth, mask = World((BOX,)).depth()
    metres = depth.metres.copy()
    metres[mask] = 0
    with pytest.raises(InvalidInput, match="no data within the mask"):
        find_object(DepthImage(metres), View().camera, View().base_T_camera, mask=mask)


def test_real_kinect_frames_give_their_labelled_tables_and_pure_objects() -> None:
    frames = sorted((SHARED / "data/real_depth/mosd_kinect_v1").glob("test*.json"))[::12]
    if not frames:
        pytest.skip(f"no real depth frames below {SHARED}")
    for frame in frames:
        about = json.loads(frame.read_text())
        values = np.array(Image.open(frame.with_name(about["files"]["depth"]))).astype(np.uint16)
        labels = np.array(Image.open(frame.with_name(about["files"]["label"])))
        depth = DepthImage.from_values(values, about["depth_unit_m"])
        camera = Camera(about["fx"], about["fy"], about["cx"], about["cy"])
        scene = seen_in(depth, camera, Pose.identity())
        *normal, _ = about["table_plane_cam_abcd"]
        assert tilt(scene.table, np.array(normal) * np.sign(scene.table.normal @ normal)) < 0.2
        assert (labels[scene.mask] >= 2).mean() > 0.95
