"""A wide beam that is described as thin is detected; a thin one is not taken to be wide."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.scenes import KINECT, Box, World
from pretouch_registrar.engines.beam_width import ASSUMED_HALF_ANGLE
from pretouch_registrar.registration import Registrar, Settings

from pretouch.estimate import Estimate
from pretouch.geometry import Array, Pose, rotation_from_vector
from pretouch.prior import Prior
from pretouch.scene import Scene
from pretouch.tof import Scan, Sensor

REGISTRAR = Registrar()
THIN = Sensor()
CONE = Sensor(beam_half_angle=ASSUMED_HALF_ANGLE)
OBJECT = (Box.standing((0.10, 0.06, 0.05), (0.0, 0.0), 0.4), Box.standing((0.03, 0.03, 0.02), (0.25, 0.25)))
LINES = (((-0.09, -0.01), (0.09, 0.01)), ((0.01, -0.09), (-0.01, 0.09)), ((-0.08, 0.05), (0.08, -0.04)))
CORRECTIONS = (
    ((0.03, -0.02, 0.06), (0.012, -0.008, 0.006)),
    ((-0.04, 0.03, 0.01), (-0.005, 0.014, -0.009)),
    ((0.00, 0.05, -0.05), (0.010, 0.010, 0.012)),
)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return World(OBJECT).scene(KINECT, np.random.default_rng(5)).cropped(0.1)[0]


def measured(truth: World, half_angle: float, rng: np.random.Generator) -> list[Scan]:
    """Scans along LINES from 85 mm above: each range the distance of the nearest thing within `half_angle`, rad, of the
    beam, which no hypothesis of the engine is; with noise of 1.5 mm."""
    turns = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    tilts = np.repeat(np.linspace(0, half_angle, 4), 12)
    bundle = np.column_stack([np.sin(tilts) * np.tile(np.cos(turns), 4), np.sin(tilts) * np.tile(np.sin(turns), 4)])
    rays = np.column_stack([bundle, -np.cos(tilts)])
    return [_line(truth, rays, np.linspace(start, end, 90), rng) for start, end in LINES]


def _line(truth: World, rays: Array, places: Array, rng: np.random.Generator) -> Scan:
    origins = np.column_stack([places, np.full(len(places), 0.085)])
    paths = truth.cast(
        np.repeat(origins[:, None], len(rays), axis=1), np.broadcast_to(rays, (len(places), *rays.shape))
    )
    ranges = paths[0].min(axis=1) + rng.normal(0, 0.0015, len(places))
    return Scan(origins, np.tile([0.0, 0.0, -1.0], (len(places), 1)), np.where(ranges <= 0.1, ranges, np.nan))


def registered(scene: Scene, scans: list[Scan], sensor: Sensor) -> Estimate:
    return REGISTRAR.register(scene, scans, Settings(prior=Prior(), sensor=sensor))


def truth_of(scene: Scene, correction: tuple[tuple[float, ...], tuple[float, ...]]) -> Pose:
    turn = rotation_from_vector(correction[0])
    return Pose.of(turn, scene.centroid + correction[1] - turn @ scene.centroid)


@pytest.mark.parametrize("correction", CORRECTIONS)
@pytest.mark.parametrize("half_angle", [np.radians(12.5), np.radians(15.0)])
def test_a_wide_beam_described_as_thin_is_registered_as_a_wide_one(
    scene: Scene, correction: tuple[tuple[float, ...], tuple[float, ...]], half_angle: float
) -> None:
    truth = truth_of(scene, correction)
    scans = measured(World(OBJECT).moved(truth), half_angle, np.random.default_rng(3))
    answer, described = registered(scene, scans, THIN), registered(scene, scans, CONE)
    np.testing.assert_array_equal(answer.base_T_correction.matrix, described.base_T_correction.matrix)
    np.testing.assert_array_equal(answer.covariance, described.covariance)
    error = np.linalg.norm(answer.base_T_correction.apply(scene.cloud) - truth.apply(scene.cloud), axis=1).mean()
    assert error < 2 * answer.expected_error


@pytest.mark.parametrize("correction", CORRECTIONS)
@pytest.mark.parametrize("range_std", [0.0005, 0.0015, 0.0045])
def test_a_thin_beam_stays_one(
    scene: Scene, correction: tuple[tuple[float, ...], tuple[float, ...]], range_std: float
) -> None:
    scans = measured(World(OBJECT).moved(truth_of(scene, correction)), 0.0, np.random.default_rng(3))
    answer = registered(scene, scans, replace(THIN, range_std=range_std))
    assert answer.expected_error < 0.6 * registered(scene, scans, CONE).expected_error


@pytest.mark.parametrize("correction", CORRECTIONS)
def test_points_without_beams_are_a_thin_beams(
    scene: Scene, correction: tuple[tuple[float, ...], tuple[float, ...]]
) -> None:
    truth = truth_of(scene, correction)
    scans = measured(World(OBJECT).moved(truth), 0.0, np.random.default_rng(3))
    points = [Scan.of_points(scan.points(), [0.0, 0.0, -1.0]) for scan in scans]
    answer = registered(scene, points, THIN)
    error = np.linalg.norm(answer.base_T_correction.apply(scene.cloud) - truth.apply(scene.cloud), axis=1).mean()
    assert error < 0.005
    assert answer.expected_error < 0.6 * registered(scene, scans, CONE).expected_error
