"""The fingertip's path keeps its distance, speed and orientation, and covers the object."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.scenes import KINECT, Box, View, World, looking
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_orchestrator.planning.path import plan_paths
from scipy.spatial import KDTree

from pretouch.camera import DepthImage
from pretouch.estimate import Estimate, from_prior
from pretouch.geometry import Array, Pose, rotation_from_vector
from pretouch.prior import Prior
from pretouch.rectangle import RotatedRectangle
from pretouch.scene import Scene
from pretouch.session import ScanSettings
from pretouch.trajectory import Trajectory

FINGER = 0.010
CLOSEST = 0.005


def estimated(scene: Scene, correction: Pose, translation_std: float, rotation_std: float) -> Estimate:
    covariance = np.diag([rotation_std**2] * 3 + [translation_std**2] * 3)
    return Estimate(correction, scene.centroid, covariance, 0.01, 0.02)


def rectangle_over(scene: Scene, x: float, y: float, w: float, h: float, theta: float) -> RotatedRectangle:
    """A rectangle placed and sized in shares of the object's bounding box."""
    u0, v0, u1, v1 = scene.bounds()
    return RotatedRectangle(u0 + x * (u1 - u0), v0 + y * (v1 - v0), w * (u1 - u0), h * (v1 - v0), theta)


def true_correction(estimate: Estimate, error: Array) -> Pose:
    """The truth if `estimate` errs by (w, d)."""
    w, d = np.split(error, 2)
    rotation = rotation_from_vector(w) @ estimate.base_T_correction.rotation
    to = estimate.base_T_correction.apply(estimate.centroid) + d
    return Pose.of(rotation, to - rotation @ estimate.centroid)


def worst_errors(scene: Scene, estimate: Estimate, rng: np.random.Generator) -> Array:
    """Errors (n, 6), 3.7 standard deviations out: any, and those that lift or shift what is at the corners most."""
    root = np.linalg.cholesky(estimate.covariance)
    ways = list(rng.normal(size=(60, 6)))
    for x in (-0.1, 0.1):
        for y in (-0.1, 0.1):
            ways.append(root.T @ (y, -x, 0, 0, 0, 1))
            ways.append(root.T @ (0, 0.05, -y, 1, 0, 0))
            ways.append(root.T @ (0, 0.05, -y, -1, 0, 0))
    return np.array([root @ (3.7 * way / np.linalg.norm(way)) for way in ways])


def dense(path: Trajectory, step: float = 0.001) -> Array:
    """Tip positions along the path, at most about `step` m apart."""
    times = np.linspace(0.0, path.t[-1], 2 + int(path.length / step))
    return np.stack([np.interp(times, path.t, path.base_T_tip[:, k, 3]) for k in range(3)], axis=1)


def placed(
    object_sides: tuple[float, ...], yaw: float, others: list[tuple[tuple[float, ...], float, float, float]]
) -> World:
    """The object, and others about it: their sides, how far and in which direction they stand, and their turns."""
    boxes = [Box.standing(size, (r * np.cos(a), r * np.sin(a)), turn) for size, r, a, turn in others]
    return World((Box.standing(object_sides, yaw=yaw), *boxes))


sides = st.tuples(st.floats(0.03, 0.14), st.floats(0.03, 0.14), st.floats(0.01, 0.14))
neighbours = st.lists(st.tuples(sides, st.floats(0.05, 0.2), st.floats(-3.1, 3.1), st.floats(-3, 3)), max_size=2)
worlds = st.builds(placed, sides, st.floats(-3, 3), neighbours)
rectangles = st.lists(
    st.tuples(*[st.floats(0, 1)] * 2, *[st.floats(0.1, 1.3)] * 2, st.floats(-1.5, 1.5)), min_size=1, max_size=4
)
corrections = st.builds(
    Pose.from_rotation_vector, st.tuples(*[st.floats(-0.1, 0.1)] * 3), st.tuples(*[st.floats(-0.02, 0.02)] * 3)
)


@settings(max_examples=30, deadline=None)
@given(
    world=worlds,
    boxes=rectangles,
    correction=corrections,
    prior=st.builds(Prior, st.floats(0.0005, 0.015), st.floats(0.001, 0.06)),
    scan=st.builds(ScanSettings, st.floats(0.012, 0.05), st.floats(0.02, 0.2)),
    down=st.floats(35, 70),
    seed=st.integers(0, 1000),
)
def test_whatever_is_there_the_tip_keeps_clear_of_it_and_within_its_speed(
    world: World,
    boxes: list[tuple[float, ...]],
    correction: Pose,
    prior: Prior,
    scan: ScanSettings,
    down: float,
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    view = View(looking((0, 0, 0.02), 0.8, down))
    depth, mask = world.depth(view, rng)
    if mask.sum() < 60:
        return
    scene, _ = Scene(depth, view.camera, view.base_T_camera, mask, world.table).cropped(0.15)
    estimate = estimated(scene, correction, prior.translation_std, prior.rotation_std)
    truths = [world.moved(true_correction(estimate, error)) for error in worst_errors(scene, estimate, rng)]
    for path in plan_paths(scene, [rectangle_over(scene, *box) for box in boxes], estimate, scan):
        if path is None:
            continue
        assert path.t[0] == 0
        assert 2 <= len(path.t) <= 200
        steps = np.linalg.norm(np.diff(path.base_T_tip[:, :3, 3], axis=0), axis=1)
        assert (steps / np.diff(path.t)).max() <= scan.speed
        np.testing.assert_allclose(path.base_T_tip[:, :3, :3], path.base_T_tip[:1, :3, :3].repeat(len(path.t), 0))
        np.testing.assert_allclose(path.base_T_tip[0, :3, 2], -world.table.moved(correction).normal, atol=1e-9)
        tips = dense(path, 0.003)
        assert world.moved(correction).distance(tips).min() >= min(scan.standoff, FINGER)
        assert min(truth.distance(tips).min() for truth in truths) >= CLOSEST


def test_under_the_prior_one_scan_in_a_thousand_comes_close_at_most() -> None:
    world = World((Box.standing((0.1, 0.08, 0.05), yaw=0.5), Box.standing((0.04, 0.04, 0.1), (0.1, 0.02))))
    scene, _ = world.scene(KINECT, np.random.default_rng(0)).cropped(0.15)
    estimate = from_prior(Prior(), scene.cloud)
    boxes = [rectangle_over(scene, 0.5, 0.5, 0.6, 0.6, 0.3), rectangle_over(scene, 0.8, 0.3, 0.7, 0.5, 1.0)]
    errors = np.random.default_rng(1).multivariate_normal(np.zeros(6), estimate.covariance, 4000)
    for path in plan_paths(scene, boxes, estimate, ScanSettings()):
        assert path is not None
        tips = dense(path, 0.004)
        back = [true_correction(estimate, error).inverse() for error in errors]
        closest = world.distance(np.stack([pose.apply(tips) for pose in back])).min(axis=1)
        assert (closest < CLOSEST).mean() <= 0.001


def believed_clearance(scene: Scene, estimate: Estimate, tips: Array, radius: float) -> Array:
    """Heights (n,) of tips above the highest point that the camera saw within `radius` of their beams."""
    table = scene.table.moved(estimate.base_T_correction)
    frame = table.frame().inverse()
    seen = frame.apply(estimate.base_T_correction.apply(scene.organised[scene.depth.metres > 0]))
    places = frame.apply(tips)
    near = KDTree(seen[:, :2]).query_ball_point(places[:, :2], radius)
    return np.array([z - seen[k, 2].max(initial=0.0) for k, z in zip(near, places[:, 2], strict=True)])


@pytest.mark.parametrize(("std", "rise"), [(0.0005, 0.03), (0.003, 0.03), (0.0115, 0.051)])
def test_the_tip_keeps_the_standoff_over_all_that_may_be_near_and_no_more(std: float, rise: float) -> None:
    world = World((Box.standing((0.1, 0.08, 0.04)), Box.standing((0.05, 0.05, 0.07), (0.0, 0.11))))
    scene, _ = world.scene(KINECT, np.random.default_rng(0)).cropped(0.15)
    estimate = estimated(scene, Pose.from_rotation_vector((0.02, 0.03, 0.2), (0.01, 0, -0.01)), std, 1e-4)
    boxes = [rectangle_over(scene, 0.5, 0.5, s, s, a) for s in (0.4, 0.8, 1.0) for a in (0, 0.7)]
    paths = plan_paths(scene, boxes, estimate, ScanSettings())
    for path in paths:
        assert path is not None
        tips = dense(path)
        assert believed_clearance(scene, estimate, tips, FINGER + 3 * std).min() >= rise - 1e-4
        assert believed_clearance(scene, estimate, tips, FINGER + 4 * std + 0.012).min() < rise + 0.006


def test_the_path_rises_before_an_edge_and_follows_the_surface_beside_it() -> None:
    step = World((Box.standing((0.2, 0.1, 0.02)), Box.standing((0.1, 0.1, 0.08), (0.1, 0.0))))
    depth, _ = step.depth(KINECT)
    heights = step.scene(KINECT).organised[..., 2]
    scene, _ = Scene(depth, KINECT.camera, KINECT.base_T_camera, heights > 0.005, step.table).cropped(0.15)
    estimate = estimated(scene, Pose.identity(), 0.001, 0.001)
    (path,) = plan_paths(scene, [rectangle_over(scene, 0.5, 0.5, 0.3, 0.75, 0)], estimate, ScanSettings())
    assert path is not None
    tips = dense(path)
    low, high = tips[tips[:, 0] < 0.02], tips[tips[:, 0] > 0.045]
    assert len(low) > 20
    assert len(high) > 20
    assert low[:, 2].max() == pytest.approx(0.02 + 0.03, abs=0.006)
    assert high[:, 2].min() == pytest.approx(0.08 + 0.03, abs=0.006)


def test_a_place_that_the_camera_cannot_see_is_not_taken_for_empty() -> None:
    front, back = Box.standing((0.02, 0.1, 0.1), (-0.04, 0.0)), Box.standing((0.02, 0.1, 0.1), (0.06, 0.0))
    hidden = Box.standing((0.02, 0.08, 0.05), (0.005, 0.0))
    world = World((front, back, hidden))
    depth, _ = world.depth(KINECT)
    np.testing.assert_array_equal(depth.metres, World((front, back)).depth(KINECT)[0].metres)
    mask = world.scene(KINECT).organised[..., 2] > 0.005
    scene, _ = Scene(depth, KINECT.camera, KINECT.base_T_camera, mask, world.table).cropped(0.15)
    estimate = estimated(scene, Pose.identity(), 0.0005, 0.001)
    (path,) = plan_paths(scene, [rectangle_over(scene, 0.5, 0.5, 0.4, 0.9, 0)], estimate, ScanSettings(0.012))
    assert path is not None
    tips = dense(path)
    between = (np.abs(tips[:, 0] - 0.005) < 0.01) & (np.abs(tips[:, 1]) < 0.04)
    assert between.any()
    assert tips[between, 2].min() < 0.1
    assert world.distance(tips).min() >= 0.010


def test_a_hole_in_the_depth_image_is_bridged_and_not_taken_for_empty() -> None:
    world = World((Box.standing((0.1, 0.1, 0.06)),))
    whole, _ = world.scene(KINECT).cropped(0.15)
    u0, v0, u1, _ = whole.bounds()
    metres = whole.depth.metres.copy()
    hole = np.s_[v0 + 8 : v0 + 25, u0 - 15 : u1 + 15]
    metres[hole] = 0
    scene = Scene(DepthImage(metres), whole.camera, whole.base_T_camera, whole.mask, whole.table)
    estimate = estimated(scene, Pose.identity(), 0.0005, 0.001)
    box = rectangle_over(scene, 0.5, 0.4, 0.8, 0.7, 0)
    (path,) = plan_paths(scene, [box], estimate, ScanSettings())
    (sound,) = plan_paths(whole, [box], estimate, ScanSettings())
    assert path is not None
    assert sound is not None
    assert world.distance(dense(path)).min() >= 0.03
    assert path.length == pytest.approx(sound.length, rel=0.15)


def test_a_path_stays_near_the_object_in_one_piece() -> None:
    world = World((Box.standing((0.09, 0.06, 0.05), yaw=0.3),))
    scene, _ = world.scene(KINECT, np.random.default_rng(1)).cropped(0.15)
    cloud = KDTree(scene.cloud[:, :2])
    estimate = from_prior(Prior(0.001, 0.005), scene.cloud)
    for x, y in ((0.0, 0.2), (1.0, 0.5), (0.3, 1.0), (0.9, 0.1)):
        (path,) = plan_paths(scene, [rectangle_over(scene, x, y, 1.0, 0.9, 0.2)], estimate, ScanSettings())
        assert path is not None
        distances, _ = cloud.query(dense(path)[:, :2])
        assert distances.max() < 0.02
        assert distances.min() < 0.003
        assert np.linalg.norm(np.diff(path.base_T_tip[:, :2, 3], axis=0), axis=1).max() < 0.02


@pytest.mark.parametrize(
    "box",
    [
        RotatedRectangle(20, 20, 15, 15, 0.3),
        RotatedRectangle(160, 120, 1000, 1000, 0.0),
        RotatedRectangle(-500, -500, 30, 30, 0.0),
        RotatedRectangle(1e9, 1e9, 1e9, 1e-3, 1.0),
        RotatedRectangle(160, 120, 1e-3, 1e-3, 0.0),
    ],
    ids=["beside", "around", "outside", "absurd", "a point"],
)
def test_a_rectangle_that_would_scan_nothing_of_the_object_has_no_path(box: RotatedRectangle) -> None:
    scene = World((Box.standing((0.05, 0.05, 0.05)),)).scene()
    estimate = from_prior(Prior(), scene.cloud)
    assert plan_paths(scene, [box], estimate, ScanSettings()) == [None]


def test_a_guarded_scan_is_planned_lower_and_still_keeps_the_standoff() -> None:
    scene = World((Box.standing((0.08, 0.08, 0.05)),)).scene()
    estimate = from_prior(Prior(), scene.cloud)
    box = rectangle_over(scene, 0.5, 0.5, 0.5, 0.5, 0.0)
    heights = []
    for guarded in (False, True):
        (path,) = plan_paths(scene, [box], estimate, ScanSettings(guarded=guarded))
        assert path is not None
        heights.append(float(path.base_T_tip[:, 2, 3].max()))
    assert heights[0] > heights[1] + 0.005
    assert heights[1] >= 0.05 + ScanSettings().standoff - 0.002


def test_paths_are_planned_for_the_widest_prior_and_from_a_camera_below_the_table() -> None:
    world = World((Box.standing((0.08, 0.08, 0.05)),))
    scene = world.scene()
    box = rectangle_over(scene, 0.5, 0.5, 0.6, 0.6, 0.0)
    (path,) = plan_paths(scene, [box], from_prior(Prior(1.0, 1.0), scene.cloud), ScanSettings())
    assert path is not None
    assert path.base_T_tip[:, 2, 3].min() > 3.0
    below = Scene(
        scene.depth, scene.camera, Pose.from_rotation_vector((np.pi, 0, 0), (0, 0, -0.5)), scene.mask, world.table
    )
    plan_paths(below, [box], from_prior(Prior(), below.cloud), ScanSettings())
