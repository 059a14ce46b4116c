"""NARF's stages on an exact view of a box: borders, interest and descriptors match its shape."""

import numpy as np
import pytest
from helpers.scenes import KINECT, Box, World
from pretouch_detector.proposals.narf.borders import Borders, find_borders
from pretouch_detector.proposals.narf.change import Change, measure_change
from pretouch_detector.proposals.narf.descriptor import BEAMS, describe_keypoints
from pretouch_detector.proposals.narf.interest import compute_interest
from pretouch_detector.proposals.narf.keypoints import MIN_INTEREST, find_keypoints
from pretouch_detector.proposals.narf.promising import find_promising
from pretouch_detector.proposals.narf.range_image import RangeImage, make_range_image
from pretouch_detector.proposals.narf.surface import Surface, fit_surface
from scipy import ndimage

from pretouch.camera import Camera, DepthImage
from pretouch.scene import Scene

SUPPORT = 0.05
CAMERA = Camera(500.0, 500.0, 39.5, 39.5)
LEFT, RIGHT, TOP, BOTTOM = range(4)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return World((Box.standing((0.10, 0.07, 0.12), yaw=0.5),)).scene(KINECT).cropped(0.06)[0]


@pytest.fixture(scope="module")
def image(scene: Scene) -> RangeImage:
    return make_range_image(scene.depth, scene.camera)


@pytest.fixture(scope="module")
def planes(image: RangeImage) -> Surface:
    return fit_surface(image)


@pytest.fixture(scope="module")
def found(image: RangeImage, planes: Surface) -> Borders:
    return find_borders(image, planes)


@pytest.fixture(scope="module")
def changes(image: RangeImage, planes: Surface, found: Borders) -> Change:
    return measure_change(image, planes, found)


def test_points_are_those_of_the_camera(scene: Scene, image: RangeImage) -> None:
    points = scene.camera.back_project_image(scene.depth.metres)
    np.testing.assert_allclose(image.points, points, atol=1e-6)
    np.testing.assert_allclose(image.ranges, np.linalg.norm(points, axis=-1), rtol=1e-6)


def test_pixels_without_depth_take_part_in_nothing() -> None:
    depth = np.full((40, 40), 0.8, np.float32)
    depth[10:20, 10:20] = 0.0
    image = make_range_image(DepthImage(depth), CAMERA)
    planes = fit_surface(image)
    found = find_borders(image, planes)
    empty = depth == 0
    assert np.isnan(planes.reach[empty]).all()
    assert np.isfinite(planes.reach[~empty]).all()
    assert not found.scores[:, empty].any()
    assert not measure_change(image, planes, found).scores[empty].any()


def test_planes_lie_on_the_boxes_faces(scene: Scene, planes: Surface) -> None:
    inner = ndimage.binary_erosion(scene.mask, iterations=4)
    normals = scene.base_T_camera.rotate(planes.normals[inner].astype(np.float64))
    yaw = np.array([[np.cos(0.5), np.sin(0.5), 0], [-np.sin(0.5), np.cos(0.5), 0], [0, 0, 1]])
    nearest = np.abs(normals @ yaw.T).max(axis=1)
    assert (nearest > 0.99).mean() > 0.8  # all but those at the edges between two faces
    toward = np.einsum("ij,ij->i", planes.normals[inner], planes.means[inner])
    assert (toward < 0).all()


def test_obstacle_borders_are_the_boxes_outline_against_the_table(scene: Scene, found: Borders) -> None:
    border = found.obstacle.any(axis=0)
    rim = scene.mask & ~ndimage.binary_erosion(scene.mask)
    assert (border & scene.mask).sum() > 100
    assert not (border & ~ndimage.binary_dilation(rim, iterations=1)).any()
    assert (found.shadow & ~scene.mask).sum() > 0.9 * found.shadow.sum()
    v, u = np.nonzero(found.obstacle[LEFT])
    assert not scene.mask[v, u - 2].any()
    v, u = np.nonzero(found.obstacle[RIGHT])
    assert not scene.mask[v, u + 2].any()


def test_where_the_box_stands_on_the_table_there_is_no_border(scene: Scene, found: Borders) -> None:
    _, top, _, bottom = scene.bounds()
    assert not found.obstacle[:, bottom - 2 :, :].any()
    assert found.obstacle[TOP, top : top + 3, :].any()


def test_change_is_certain_on_borders_and_directed_outwards(scene: Scene, found: Borders, changes: Change) -> None:
    certain = changes.scores == 1
    assert certain.sum() > 0.8 * (found.obstacle.any(axis=0) & ~found.shadow & ~found.veil).sum()
    lengths = np.linalg.norm(changes.directions[certain], axis=-1)
    np.testing.assert_allclose(lengths, 1, atol=1e-5)
    v, u = np.nonzero(certain & found.obstacle[RIGHT] & ~found.obstacle[LEFT])
    assert (changes.directions[v, u, 0] > 0).all()


def test_corners_interest_faces_do_not(scene: Scene, image: RangeImage, found: Borders, changes: Change) -> None:
    hidden = found.shadow | found.veil
    values = compute_interest(image, changes, hidden, scene.mask, SUPPORT)
    assert values.min() >= 0
    assert values.max() <= 1
    assert not values[~scene.mask].any()
    pixels = find_keypoints(values, image.points, SUPPORT)
    assert len(pixels) >= 3
    assert (values[tuple(pixels.T)] >= MIN_INTEREST).all()
    assert (np.diff(values[tuple(pixels.T)]) <= 0).all()
    places = image.points[tuple(pixels.T)]
    gaps = np.linalg.norm(places[:, None] - places[None], axis=-1) + np.eye(len(places))
    assert gaps.min() >= 0.25 * SUPPORT - 1e-6
    # all of them near to where two edges of the box meet
    corners = scene.camera.project(scene.base_T_camera.inverse().apply(_corners()))
    distance = np.linalg.norm(pixels[:, None, ::-1] - corners[None], axis=-1).min(axis=1)
    assert (distance * 0.75 / scene.camera.fx < SUPPORT / 2).all()


def _corners() -> np.ndarray:
    signs = np.array([[i, j, k] for i in (-0.5, 0.5) for j in (-0.5, 0.5) for k in (0.0, 1.0)])
    c, s = np.cos(0.5), np.sin(0.5)
    return signs * (0.10, 0.07, 0.12) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])


def test_interest_is_asked_for_where_it_is_wanted(image: RangeImage, found: Borders, changes: Change) -> None:
    everywhere = np.ones(image.ranges.shape, np.bool_)
    hidden = found.shadow | found.veil
    some = np.zeros_like(everywhere)
    some[20:60, 10:50] = True
    values = compute_interest(image, changes, hidden, everywhere, SUPPORT)
    np.testing.assert_array_equal(compute_interest(image, changes, hidden, some, SUPPORT), np.where(some, values, 0))
    assert not values[hidden].any()


def test_nothing_of_interest_is_ruled_out_and_most_of_the_rest_is() -> None:
    noisy = World((Box.standing((0.10, 0.07, 0.12), yaw=0.5),)).scene(KINECT, np.random.default_rng(1)).cropped(0.04)[0]
    image = make_range_image(noisy.depth, noisy.camera)
    planes = fit_surface(image)
    found = find_borders(image, planes)
    changes, hidden = measure_change(image, planes, found), found.shadow | found.veil
    values = compute_interest(image, changes, hidden, noisy.mask, SUPPORT)
    left = find_promising(image, changes, hidden, noisy.mask, SUPPORT, MIN_INTEREST)
    assert (values >= MIN_INTEREST).any()
    assert not (values >= MIN_INTEREST)[~left].any()
    assert left.sum() < 0.5 * noisy.mask.sum()


@pytest.mark.parametrize(("side", "beam"), [("up", 0), ("right", 9), ("down", 18), ("left", 27)])
def test_the_largest_elements_point_past_the_border(side: str, beam: int) -> None:
    depth = np.full((80, 80), 0.8, np.float32)
    depth[{"up": np.s_[:35], "right": np.s_[:, 45:], "down": np.s_[45:], "left": np.s_[:, :35]}[side]] = 1.5
    values, poses = describe_keypoints(make_range_image(DepthImage(depth), CAMERA), np.array([[40, 40]]), SUPPORT)
    assert values.shape == (1, BEAMS)
    assert abs((int(values[0].argmax()) - beam + 18) % 36 - 18) <= 4
    assert values[0, beam] > 0.2
    assert abs(values[0, (beam + 18) % 36]) < 0.01
    np.testing.assert_allclose(poses[0, :, :3], np.eye(3), atol=1e-3)


def test_a_plane_has_a_descriptor_of_zeros() -> None:
    image = make_range_image(DepthImage(np.full((80, 80), 0.8, np.float32)), CAMERA)
    values, _ = describe_keypoints(image, np.array([[40, 40]]), SUPPORT)
    np.testing.assert_allclose(values, 0, atol=1e-4)


def test_a_pixel_alone_has_no_descriptor() -> None:
    depth = np.zeros((80, 80), np.float32)
    depth[40, 40] = 0.8
    values, poses = describe_keypoints(make_range_image(DepthImage(depth), CAMERA), np.array([[40, 40]]), SUPPORT)
    assert np.isnan(values).all()
    assert np.isnan(poses).all()
