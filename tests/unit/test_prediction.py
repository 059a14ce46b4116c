from dataclasses import replace

import numpy as np
import pytest
from helpers.predictions import predict_errors
from helpers.scenes import KINECT, Box, World
from pretouch_registrar.engines import camera_model
from pretouch_registrar.engines.registration_problem import RegistrationProblem, build_problem, find_beam_patches
from pretouch_registrar.prediction import Outcome, predict_candidate
from pretouch_registrar.ray_casting import cast_rays
from pretouch_registrar.registration import Registrar, Settings

from pretouch.camera import DepthImage
from pretouch.estimate import point_error
from pretouch.expected_error import compute_expected_errors
from pretouch.geometry import Pose
from pretouch.prior import Prior
from pretouch.scan_prediction import Candidate
from pretouch.scene import Scene
from pretouch.tof import Scan, Sensor
from pretouch.trajectory import Trajectory

REGISTRAR = Registrar()

SENSOR = Sensor()
BOX = World((Box.standing((0.10, 0.06, 0.05), (0.0, 0.0), 0.4),))
PRIOR = Prior()
LIFTED = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.01])


@pytest.fixture(scope="module")
def scene() -> Scene:
    return BOX.scene(KINECT).cropped(0.1)[0]


@pytest.fixture(scope="module")
def problem(scene: Scene) -> RegistrationProblem:
    return build_problem(camera_model.build(scene), [], PRIOR, SENSOR)


def line(start: tuple[float, float], end: tuple[float, float], height: float = 0.085) -> Trajectory:
    """A straight path at constant height above the table, beam down, 5 cm/s."""
    tip = np.tile(np.eye(4), (2, 1, 1))
    tip[:, :3, :3] = np.diag([1.0, -1.0, -1.0])
    tip[:, :3, 3] = [(*start, height), (*end, height)]
    return Trajectory(np.array([0.0, np.hypot(end[0] - start[0], end[1] - start[1]) / 0.05]), tip)


ACROSS = line((-0.09, -0.02), (0.09, 0.03))
TOP = line((-0.01, 0.0), (0.01, 0.005))
TABLE = line((-0.08, 0.09), (0.08, 0.09))


def beams(path: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    poses = path.sampled(SENSOR.rate).base_T_tip
    return np.ascontiguousarray(poses[:, :3, 3]), np.ascontiguousarray(poses[:, :3, 2])


def cast(problem: RegistrationProblem, truths: np.ndarray, path: Trajectory, extent: float = 0.0) -> np.ndarray:
    """The simulated ranges (t, n) of the sensor along a path."""
    origins, directions = beams(path)
    sets = (len(truths), *origins.shape)
    return cast_rays(
        problem,
        truths,
        np.broadcast_to(origins, sets).copy(),
        np.broadcast_to(directions, sets).copy(),
        np.full(len(truths), extent),
        SENSOR.range_min,
    )


def outcomes(
    problem: RegistrationProblem, covariance: np.ndarray, candidate: Candidate, sensor: Sensor = SENSOR
) -> list[Outcome]:
    earlier = find_beam_patches(problem.beams, problem.shared)
    return predict_candidate(problem, np.zeros(6), covariance, candidate, sensor, earlier)


def left(problem: RegistrationProblem, path: Trajectory) -> np.ndarray:
    return outcomes(problem, PRIOR.covariance, Candidate(path))[0].covariance


def test_a_simulated_beam_ends_where_a_real_one_does_wherever_the_camera_saw(problem: RegistrationProblem) -> None:
    origins, directions = beams(ACROSS)
    simulated = cast(problem, np.zeros((1, 6)), ACROSS)[0]
    real = BOX.cast(origins, directions)[0]
    assert (np.abs(simulated - real) < 0.004).mean() > 0.9
    assert {True, False} == set(real < 0.05)


def test_under_a_lifted_truth_every_beam_is_shorter_by_as_much(problem: RegistrationProblem) -> None:
    where, lifted = cast(problem, np.stack([np.zeros(6), LIFTED]), TOP)
    np.testing.assert_allclose(where - lifted, 0.01, atol=0.002)


def test_a_beam_whose_table_is_out_of_range_is_a_miss(problem: RegistrationProblem) -> None:
    high = line((-0.08, 0.09), (0.08, 0.09), height=0.12)
    assert np.isinf(cast(problem, np.zeros((1, 6)), high)).all()


def test_a_small_hole_in_the_object_s_depth_is_not_taken_for_table() -> None:
    scene = BOX.scene(KINECT).cropped(0.1)[0]
    hole = scene.mask & (np.linalg.norm(scene.organised - (0.0, 0.0, 0.05), axis=-1) < 0.005)
    assert hole.sum() > 10
    holed = replace(scene, depth=DepthImage(np.where(hole, 0, scene.depth.metres)))
    problem = build_problem(camera_model.build(holed), [], PRIOR, SENSOR)
    assert cast(problem, np.zeros((1, 6)), line((0.0, 0.0), (0.001, 0.0)))[0, 0] == pytest.approx(0.035, abs=0.013)


def test_a_path_over_bare_table_tells_its_height_and_nothing_sideways(problem: RegistrationProblem) -> None:
    before, after = np.sqrt(np.diag(PRIOR.covariance)), np.sqrt(np.diag(left(problem, TABLE)))
    assert after[5] < 0.8 * before[5]
    assert (after[3:5] > 0.75 * before[3:5]).all()


def test_a_path_across_the_edges_leaves_less_than_one_on_the_top_and_that_less_than_none(
    problem: RegistrationProblem, scene: Scene
) -> None:
    cloud = scene.cloud
    none, top, across = (
        point_error(covariance, cloud, problem.target.centroid)[0]
        for covariance in (PRIOR.covariance, left(problem, TOP), left(problem, ACROSS))
    )
    assert across < 0.9 * top < 0.9 * none


def test_a_predicted_covariance_is_one(problem: RegistrationProblem) -> None:
    covariance = left(problem, ACROSS)
    np.testing.assert_allclose(covariance, covariance.T, atol=1e-12)
    assert (np.linalg.eigvalsh(covariance) > 0).all()
    assert (np.linalg.eigvalsh(PRIOR.covariance - covariance) > -1e-9).all()


def test_the_number_of_modules_does_not_overstate_what_a_scan_tells(problem: RegistrationProblem) -> None:
    hand = replace(SENSOR, tip_T_module=(Pose.identity(),) * 3)
    many = outcomes(problem, PRIOR.covariance, Candidate(ACROSS), hand)[0].covariance
    np.testing.assert_allclose(np.diag(many), np.diag(left(problem, ACROSS)), rtol=0.3)


def test_the_same_scan_again_is_predicted_to_tell_less_than_a_new_one() -> None:
    scene = BOX.scene(KINECT, np.random.default_rng(5)).cropped(0.1)[0]
    first: list[Scan] = [BOX.scanned(ACROSS, SENSOR, np.random.default_rng(0)).beams(SENSOR)]
    again, new = predict_errors(REGISTRAR, scene, first, Settings(), [ACROSS, line((0.02, -0.08), (-0.03, 0.08))])
    assert new < again


def test_a_piece_tells_less_than_the_path_and_a_whole_span_as_much(problem: RegistrationProblem) -> None:
    end = ACROSS.duration
    candidate = Candidate(ACROSS, ((0.0, end), (0.0, 0.3 * end), (0.7 * end, end)))
    arms = np.random.default_rng(0).uniform(-0.04, 0.04, (50, 3))
    whole, *pieces = compute_expected_errors(
        [left for left, _ in outcomes(problem, PRIOR.covariance, candidate)],
        arms,
    )
    (alone,) = compute_expected_errors(left(problem, ACROSS)[None], arms)
    assert whole == pytest.approx(alone, rel=0.1)
    assert (whole < 0.95 * np.array(pieces)).all()


def test_shares_of_returns_are_those_of_the_finger_in_the_world(problem: RegistrationProblem) -> None:
    high = line((-0.09, -0.02), (0.09, 0.03), height=0.12)
    spans = ((0.0, 0.6), (1.2, 2.0), (0.0, high.duration))
    predicted = outcomes(problem, 1e-8 * np.eye(6), Candidate(high, spans))
    for (start, end), outcome in zip(spans, predicted, strict=True):
        samples = BOX.scanned(high.between(start, end), SENSOR)
        assert outcome.returns == pytest.approx(np.isfinite(samples.range).mean(), abs=0.12)


def test_other_things_stop_beams_too() -> None:
    both = World((*BOX.boxes, Box.standing((0.05, 0.05, 0.05), (0.0, 0.11))))
    scene = both.scene(KINECT).cropped(0.12)[0]
    high = line((0.0, 0.10), (0.0, 0.12), height=0.12)
    problem = build_problem(camera_model.build(scene), [], PRIOR, SENSOR)
    assert cast(problem, np.zeros((1, 6)), high)[0] == pytest.approx(0.07, abs=0.004)


def test_hidden_places_within_the_extent_are_solid_up_to_the_line_of_sight(problem: RegistrationProblem) -> None:
    away = BOX.scene(KINECT).base_T_camera.translation[:2]
    behind = -away / np.linalg.norm(away) * 0.075
    path = line(tuple(behind), tuple(behind * 1.05), height=0.085)
    table, solid = (cast(problem, np.zeros((1, 6)), path, extent)[0] for extent in (0.0, 0.05))
    assert (table > 0.08).all()
    assert (solid < table - 0.01).all()
