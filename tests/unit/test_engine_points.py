"""The engines that match points find the pose, and state a wide covariance where samples do not determine it."""

import numpy as np
import pytest
from helpers.predictions import predict_errors
from helpers.scenes import KINECT, Box, World
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_registrar.engines import Engine, paper, pcl
from pretouch_registrar.engines.icp import LAMBDA, MAX_DISTANCE, MIN_CORRESPONDENCES
from pretouch_registrar.registration import Registrar, Settings
from scipy.spatial import cKDTree

from pretouch.geometry import Pose, rotation_from_vector
from pretouch.prior import Prior
from pretouch.scene import Scene
from pretouch.tof import Scan, Sensor
from pretouch.trajectory import Trajectory

REGISTRAR = Registrar()

POINT_ENGINES = [Engine.POINT_TO_PLANE, Engine.PAPER, Engine.PCL]
SENSOR = Sensor()
OBJECT = (Box.standing((0.10, 0.06, 0.05), (0.0, 0.0), 0.4),)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return World(OBJECT).scene(KINECT, np.random.default_rng(5)).cropped(0.1)[0]


def line(start: tuple[float, float], end: tuple[float, float]) -> Trajectory:
    tip = np.tile(np.eye(4), (2, 1, 1))
    tip[:, :3, :3] = np.diag([1.0, -1.0, -1.0])
    tip[:, :2, 3] = start, end
    tip[:, 2, 3] = 0.085
    return Trajectory(np.array([0.0, np.linalg.norm(np.subtract(end, start)) / 0.05]), tip)


PATHS = (line((-0.08, -0.01), (0.08, 0.01)), line((0.01, -0.08), (-0.01, 0.08)), line((-0.07, 0.05), (0.07, -0.04)))


def scanned(scene: Scene, shift: tuple[float, float, float]) -> tuple[Pose, list[Scan]]:
    truth = Pose.of(np.eye(3), shift)
    world, rng = World(OBJECT).moved(truth), np.random.default_rng(0)
    return truth, [world.scanned(path, SENSOR, rng).beams(SENSOR) for path in PATHS]


def published(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Phillips et al. written out plainly: a 4x4 `target_T_source`."""
    tree, total, previous = cKDTree(target), np.eye(4), np.inf
    for _ in range(50):
        moved = source @ total[:3, :3].T + total[:3, 3]
        distance, index = tree.query(moved, distance_upper_bound=MAX_DISTANCE)
        paired = np.flatnonzero(np.isfinite(distance))
        order = paired[np.argsort(distance[paired], kind="stable")]
        k = np.arange(1, len(order) + 1)
        frmsd = np.sqrt(np.cumsum(distance[order] ** 2) / k) / (k / len(order)) ** LAMBDA
        least = MIN_CORRESPONDENCES - 1 + int(np.argmin(frmsd[MIN_CORRESPONDENCES - 1 :]))
        a, b = moved[order[: least + 1]], target[index[order[: least + 1]]]
        u, _, vt = np.linalg.svd((a - a.mean(axis=0)).T @ (b - b.mean(axis=0)))
        rotation = vt.T @ np.diag([1, 1, np.sign(np.linalg.det(vt.T @ u.T))]) @ u.T
        step = np.eye(4)
        step[:3, :3], step[:3, 3] = rotation, b.mean(axis=0) - rotation @ a.mean(axis=0)
        total = step @ total
        if abs(previous - frmsd[least]) < 1e-8:
            break
        previous = frmsd[least]
    return total


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_the_compiled_match_is_the_published_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    target = rng.uniform(-0.05, 0.05, (500, 3)) * (1, 1, 0.1)
    motion = Pose.from_rotation_vector(rng.uniform(-0.06, 0.06, 3), rng.uniform(-0.01, 0.01, 3))
    source = motion.apply(target[:120]) + rng.normal(0, 0.0015, (120, 3))
    found = paper.align(source, target)
    assert found is not None
    np.testing.assert_allclose(found.matrix, published(source, target), atol=1e-7)


def test_pcls_rejector_goes_by_the_order_of_the_points_and_the_published_one_does_not() -> None:
    rng = np.random.default_rng(3)
    target = rng.uniform(-0.05, 0.05, (500, 3)) * (1, 1, 0.1)
    source = Pose.from_rotation_vector([0.05, 0.02, -0.04], [0.01, -0.01, 0.008]).apply(target[:120])
    source[:30] += rng.uniform(0.01, 0.02, (30, 3))
    turned = source[::-1].copy()
    assert not pcl.align(source, target).is_close(pcl.align(turned, target), 1e-3)
    assert paper.align(source, target).is_close(paper.align(turned, target), 1e-6)


@pytest.mark.parametrize("engine", [Engine.POINT_TO_PLANE, Engine.PAPER])
def test_a_shift_upwards_is_found(scene: Scene, engine: Engine) -> None:
    truth, scans = scanned(scene, (0.0, 0.0, 0.01))
    answer = REGISTRAR.register(scene, scans, Settings(engine=engine))
    apart = truth.apply(scene.cloud) - answer.base_T_correction.apply(scene.cloud)
    assert np.linalg.norm(apart, axis=1).mean() < 0.008
    again = REGISTRAR.register(scene, scans[::-1], Settings(engine=engine))
    assert again.base_T_correction.is_close(answer.base_T_correction, 0)


def test_map_finds_the_height_and_its_region_holds_the_truth_along_the_flat_top_too(scene: Scene) -> None:
    truth, scans = scanned(scene, (0.004, -0.003, 0.01))
    answer = REGISTRAR.register(scene, scans, Settings(engine=Engine.POINT_TO_PLANE))
    apart = truth.apply(scene.cloud) - answer.base_T_correction.apply(scene.cloud)
    assert abs(apart.mean(axis=0)[2]) < 0.001
    assert answer.expected_error < 0.8 * REGISTRAR.register(scene, [], Settings()).expected_error
    shift = np.concatenate([np.zeros(3), apart.mean(axis=0)])
    assert shift @ np.linalg.solve(answer.covariance, shift) < 12.59


@pytest.mark.parametrize("engine", [Engine.PAPER, Engine.PCL])
def test_engines_without_an_uncertainty_state_the_priors_at_least_and_predict_no_gain(
    scene: Scene, engine: Engine
) -> None:
    _, scans = scanned(scene, (0.0, 0.0, 0.01))
    answer = REGISTRAR.register(scene, scans, Settings(engine=engine))
    assert np.linalg.eigvalsh(answer.covariance - Prior().covariance).min() > -1e-9
    assert predict_errors(REGISTRAR, scene, scans, Settings(engine=engine), PATHS[:2]) == [answer.expected_error] * 2


def test_map_predicts_that_another_scan_tells_more(scene: Scene) -> None:
    _, scans = scanned(scene, (0.0, 0.0, 0.01))
    choice = Settings(engine=Engine.POINT_TO_PLANE)
    assert (
        predict_errors(REGISTRAR, scene, scans[:1], choice, PATHS[1:2])[0]
        < REGISTRAR.register(scene, scans[:1], choice).expected_error
    )


@pytest.mark.parametrize("engine", POINT_ENGINES)
@pytest.mark.parametrize("case", ["all misses", "two points", "a line", "one place", "half a metre away", "no object"])
def test_samples_that_determine_no_pose_leave_the_prior_or_a_wide_covariance(
    scene: Scene, engine: Engine, case: str
) -> None:
    down = np.array([0.0, 0.0, -1.0])
    top = np.array([0.0, 0.0, 0.05])
    rng = np.random.default_rng(0)
    along = np.linspace(-0.03, 0.03, 100)[:, None] * (1.0, 0.0, 0.0)
    points = {
        "all misses": top + along,
        "two points": top + along[[0, -1]],
        "a line": top + along,
        "one place": np.repeat(top[None], 5000, axis=0),
        "half a metre away": top + rng.normal(0, 0.02, (100, 3)) + (0.5, 0.5, 0.0),
        "no object": along,
    }[case]
    scan = Scan.of_points(points, down)
    if case == "all misses":
        scan = Scan(points, np.broadcast_to(down, points.shape), np.full(len(points), np.nan))
    answer = REGISTRAR.register(scene, [scan], Settings(engine=engine))
    correction = answer.base_T_correction
    assert np.linalg.norm(correction.apply(scene.cloud) - scene.cloud, axis=1).mean() < 0.01
    assert answer.error_quantile > 0.02
    free = answer.covariance[[0, 1, 2, 3, 4], [0, 1, 2, 3, 4]] / Prior().covariance.diagonal()[:5]
    assert free.max() > 0.9
    if engine is not Engine.POINT_TO_PLANE or case in ("all misses", "half a metre away", "no object"):
        assert correction.is_close(Pose.identity(), 1e-12)


def test_map_counts_a_point_repeated_once(scene: Scene) -> None:
    _, scans = scanned(scene, (0.0, 0.0, 0.005))
    points = scans[0].points()
    down = np.array([0.0, 0.0, -1.0])
    choice = Settings(engine=Engine.POINT_TO_PLANE)
    once = REGISTRAR.register(scene, [Scan.of_points(points, down)], choice)
    often = REGISTRAR.register(scene, [Scan.of_points(np.repeat(points, 20, axis=0), down)], choice)
    assert often.expected_error == pytest.approx(once.expected_error, rel=0.05)


def test_a_turned_object_is_turned_back_by_map(scene: Scene) -> None:
    rotation = rotation_from_vector([0.0, 0.05, 0.0])
    truth = Pose.of(rotation, scene.centroid - rotation @ scene.centroid)
    world, rng = World(OBJECT).moved(truth), np.random.default_rng(0)
    scans = [world.scanned(path, SENSOR, rng).beams(SENSOR) for path in PATHS]
    answer = REGISTRAR.register(scene, scans, Settings(engine=Engine.POINT_TO_PLANE))
    normal = answer.base_T_correction.rotate([0.0, 0.0, 1.0])
    np.testing.assert_allclose(normal, rotation @ (0.0, 0.0, 1.0), atol=0.025)
