"""The registrar on exact boxes: it finds the calibration error, with a covariance of the right size."""

import numpy as np
import pytest
from helpers.predictions import predict_errors
from helpers.scenes import KINECT, Box, World, looking
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_registrar.engines import Engine, paper
from pretouch_registrar.registration import Registrar, Settings

from pretouch.errors import PretouchError
from pretouch.estimate import point_error
from pretouch.geometry import Pose, rotation_from_vector, vector_from_rotation
from pretouch.prior import Prior
from pretouch.scan_prediction import Candidate
from pretouch.scene import Scene
from pretouch.tof import Scan, Sensor
from pretouch.trajectory import Trajectory

REGISTRAR = Registrar()

SENSOR = Sensor()
OBJECT = (
    Box.standing((0.10, 0.06, 0.05), (0.0, 0.0), 0.4),
    Box.standing((0.03, 0.03, 0.02), (0.25, 0.25)),
)


def correction_of(scene: Scene, w: tuple[float, ...], d: tuple[float, ...]) -> Pose:
    rotation = rotation_from_vector(w)
    return Pose.of(rotation, scene.centroid + d - rotation @ scene.centroid)


def line(start: tuple[float, float], end: tuple[float, float], height: float = 0.085) -> Trajectory:
    """A straight path at constant height above the table, beam down, 5 cm/s."""
    tip = np.tile(np.eye(4), (2, 1, 1))
    tip[:, :3, :3] = np.diag([1.0, -1.0, -1.0])
    tip[:, :2, 3] = start, end
    tip[:, 2, 3] = height
    return Trajectory(np.array([0.0, np.linalg.norm(np.subtract(end, start)) / 0.05]), tip)


PATHS = (
    line((-0.08, -0.01), (0.08, 0.01)),
    line((0.01, -0.08), (-0.01, 0.08)),
    line((-0.07, 0.05), (0.07, -0.04)),
    line((0.035, -0.07), (0.04, 0.07)),
)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return World(OBJECT).scene(KINECT, np.random.default_rng(5)).cropped(0.1)[0]


def scans_of(scene: Scene, correction: Pose, paths: tuple[Trajectory, ...], seed: int = 0) -> list[Scan]:
    truth = World(OBJECT).moved(correction)
    rng = np.random.default_rng(seed)
    return [truth.scanned(path, SENSOR, rng).beams(SENSOR) for path in paths]


def mean_error(scene: Scene, truth: Pose, estimate: Pose) -> float:
    return float(np.linalg.norm(truth.apply(scene.cloud) - estimate.apply(scene.cloud), axis=1).mean())


def mahalanobis(scene: Scene, truth: Pose, answer) -> float:  # type: ignore[no-untyped-def]
    estimate = answer.base_T_correction
    error = np.concatenate(
        [
            vector_from_rotation(truth.rotation @ estimate.rotation.T),
            truth.apply(scene.centroid) - estimate.apply(scene.centroid),
        ]
    )
    return float(error @ np.linalg.solve(answer.covariance, error))


OFFSETS = [
    ((0.05, -0.04, 0.07), (0.015, -0.012, 0.01)),
    ((-0.06, 0.03, -0.05), (-0.017, 0.016, -0.014)),
    ((0.0, 0.07, 0.03), (0.018, 0.018, 0.005)),
]


@pytest.mark.parametrize(("w", "d"), OFFSETS)
def test_map_finds_a_hidden_offset_and_grows_surer(scene: Scene, w: tuple[float, ...], d: tuple[float, ...]) -> None:
    truth = correction_of(scene, w, d)
    scans = scans_of(scene, truth, PATHS)
    answers = [REGISTRAR.register(scene, scans[:k], Settings()) for k in range(5)]
    assert mean_error(scene, truth, answers[0].base_T_correction) > 0.015
    assert mean_error(scene, truth, answers[4].base_T_correction) < 0.005
    assert answers[4].expected_error < 0.005 < answers[0].expected_error
    assert answers[4].error_quantile > answers[4].expected_error
    assert mahalanobis(scene, truth, answers[4]) < 16.8  # the 99 % region
    assert answers[4].inliers > 0.6 * answers[4].samples
    assert answers[4].rmse < 0.003
    for answer in answers:
        np.testing.assert_allclose(answer.covariance, answer.covariance.T, atol=1e-12)
        assert np.linalg.eigvalsh(answer.covariance).min() > 0


def test_the_order_of_the_scans_does_not_matter(scene: Scene) -> None:
    scans = scans_of(scene, correction_of(scene, *OFFSETS[0]), PATHS)
    forward, backward = REGISTRAR.register(scene, scans, Settings()), REGISTRAR.register(scene, scans[::-1], Settings())
    assert forward.base_T_correction.is_close(backward.base_T_correction, 0)
    np.testing.assert_array_equal(forward.covariance, backward.covariance)


def test_without_a_scan_the_prior_is_the_answer(scene: Scene) -> None:
    prior = Prior(0.02, 0.1)
    answer = REGISTRAR.register(scene, [], Settings(prior=prior))
    assert answer.base_T_correction.is_close(Pose.identity())
    np.testing.assert_array_equal(answer.covariance, prior.covariance)
    assert answer.expected_error == point_error(prior.covariance, scene.cloud, scene.centroid)[0]


def test_a_scan_of_the_flat_top_alone_leaves_the_horizontal_free_and_says_so(scene: Scene) -> None:
    truth = correction_of(scene, (0, 0, 0), (0.0, 0.0, 0.012))
    answer = REGISTRAR.register(scene, scans_of(scene, truth, (line((-0.01, 0.0), (0.01, 0.005)),)), Settings())
    std = np.sqrt(np.diag(answer.covariance))
    assert std[5] < 0.004 < 0.006 < min(std[3], std[4])
    assert answer.unobservable
    assert all(np.linalg.norm(weak.direction) == pytest.approx(1) for weak in answer.unobservable)
    assert any("sliding along" in weak.text for weak in answer.unobservable[:3])
    assert list(answer.unobservable) == sorted(answer.unobservable, key=lambda weak: -weak.std)


@pytest.mark.parametrize("engine", list(Engine))
@pytest.mark.parametrize("case", ["misses", "one point", "a line", "far away", "duplicates"])
def test_poor_samples_give_a_wide_covariance(scene: Scene, engine: Engine, case: str) -> None:
    down = np.array([0.0, 0.0, -1.0])
    centre = scene.centroid
    points = {
        "one point": centre[None],
        "a line": centre + np.linspace(-0.02, 0.02, 60)[:, None] * (1, 0, 0),
        "far away": centre + np.random.default_rng(0).normal(0, 0.02, (60, 3)) + (0.5, 0.5, 0.3),
        "duplicates": np.repeat(centre[None], 300, axis=0),
    }
    if case == "misses":
        origins = centre + np.linspace(-0.1, 0.1, 60)[:, None] * (1, 0, 0) + (0, 0, 0.3)
        scan = Scan(origins, np.broadcast_to(down, (60, 3)), np.full(60, np.nan))
    else:
        scan = Scan.of_points(points[case], down)
    answer = REGISTRAR.register(scene, [scan], Settings(engine=engine))
    assert np.isfinite(answer.base_T_correction.matrix).all()
    assert answer.error_quantile > 0.01
    assert np.linalg.eigvalsh(answer.covariance).min() > 0


def test_a_scan_with_nan_or_an_infinite_range_is_refused() -> None:
    with pytest.raises(PretouchError):
        Scan(np.full((3, 3), np.nan), np.tile([0.0, 0.0, -1.0], (3, 1)), np.zeros(3))
    with pytest.raises(PretouchError):
        Scan(np.zeros((3, 3)), np.tile([0.0, 0.0, -1.0], (3, 1)), np.full(3, np.inf))


def test_a_path_across_edges_is_predicted_to_tell_more_than_one_on_the_flat_top(scene: Scene) -> None:
    first = scans_of(scene, Pose.identity(), PATHS[:1])
    flat, across = predict_errors(REGISTRAR, scene, first, Settings(), [line((-0.01, 0.0), (0.01, 0.005)), PATHS[1]])
    present = REGISTRAR.register(scene, first, Settings()).expected_error
    assert across < flat
    assert across < 0.8 * present
    assert flat < 1.1 * present


def test_the_predicted_error_is_what_the_estimate_says_after_the_scan(scene: Scene) -> None:
    scans = scans_of(scene, correction_of(scene, *OFFSETS[2]), PATHS)
    predicted = predict_errors(REGISTRAR, scene, scans[:2], Settings(), [PATHS[2], PATHS[3]])
    after = [REGISTRAR.register(scene, [*scans[:2], scan], Settings()).expected_error for scan in scans[2:]]
    np.testing.assert_allclose(predicted, after, rtol=0.5)


def test_the_papers_engine_finds_a_small_shift_and_claims_no_certainty(scene: Scene) -> None:
    truth = correction_of(scene, (0, 0, 0), (0, 0, 0.008))
    scans = scans_of(scene, truth, PATHS)
    answer = REGISTRAR.register(scene, scans, Settings(engine=Engine.PAPER))
    assert mean_error(scene, truth, answer.base_T_correction) < mean_error(scene, truth, Pose.identity())
    np.testing.assert_array_equal(answer.covariance, Prior().covariance)
    assert (
        predict_errors(REGISTRAR, scene, scans, Settings(engine=Engine.PAPER), PATHS[:2]) == [answer.expected_error] * 2
    )


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_the_papers_icp_ignores_outliers_of_an_exact_match(seed: int) -> None:
    rng = np.random.default_rng(seed)
    target = rng.uniform(-0.1, 0.1, (400, 3))
    motion = Pose.from_rotation_vector(rng.uniform(-0.01, 0.01, 3), rng.uniform(-0.002, 0.002, 3))
    source = motion.inverse().apply(target[:120])
    source[:12] += rng.uniform(0.02, 0.04, (12, 3))
    found = paper.align(source, target)
    assert found is not None
    assert found.is_close(motion, 1e-6)


def test_the_view_from_the_other_side_agrees() -> None:
    world = World(OBJECT)
    view = type(KINECT)(looking((0, 0, 0.02), azimuth=60.0), KINECT.camera, KINECT.width, KINECT.height)
    scene = world.scene(view, np.random.default_rng(1)).cropped(0.1)[0]
    truth = correction_of(scene, *OFFSETS[1])
    answer = REGISTRAR.register(scene, scans_of(scene, truth, PATHS), Settings())
    assert mean_error(scene, truth, answer.base_T_correction) < 0.005


def test_where_the_error_counts_changes_what_is_stated_and_not_the_answer(scene: Scene) -> None:
    scans = scans_of(scene, correction_of(scene, *OFFSETS[0]), PATHS[:1])
    at = scene.centroid + np.array([[0.0, 0.0, -0.01], [0.0, 0.0, 0.03]])
    whole, there = REGISTRAR.register(scene, scans, Settings()), REGISTRAR.register(scene, scans, Settings(), at)
    for name in ("covariance", "centroid"):
        np.testing.assert_array_equal(getattr(there, name), getattr(whole, name))
    assert there.base_T_correction.is_close(whole.base_T_correction, 0.0)
    assert (there.fit, there.inliers, there.rmse) == (whole.fit, whole.inliers, whole.rmse)
    moved = there.base_T_correction.apply
    expected, (quantile,) = point_error(there.covariance, moved(at), moved(scene.centroid))
    assert (there.expected_error, there.error_quantile) == pytest.approx((expected, quantile))
    assert [weak.text for weak in whole.unobservable] == [weak.text.partition(";")[0] for weak in there.unobservable]
    assert all(weak.matters for weak in whole.unobservable)
    expected, (quantile,) = point_error(whole.covariance, moved(scene.cloud), moved(scene.centroid))
    assert (whole.expected_error, whole.error_quantile) == (expected, quantile)


def test_scans_are_predicted_for_where_the_error_counts(scene: Scene) -> None:
    scans = scans_of(scene, correction_of(scene, *OFFSETS[1]), PATHS)
    at = scene.cloud[np.argmax(scene.cloud[:, 0])][None]
    candidates = [Candidate(path) for path in PATHS[1:]]
    predicted = REGISTRAR.predict(scene, scans[:1], Settings(), candidates, at)
    after = [REGISTRAR.register(scene, [scans[0], scan], Settings(), at).expected_error for scan in scans[1:]]
    whole = REGISTRAR.predict(scene, scans[:1], Settings(), candidates)
    for (there,), (everywhere,), error in zip(predicted, whole, after, strict=True):
        assert there.expected_error != everywhere.expected_error
        assert there.expected_returns == everywhere.expected_returns
        assert 0.4 < there.expected_error / error < 2.5
