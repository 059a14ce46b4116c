"""No estimate is less certain than the prior, whether samples are good, few, absurd or contradictory."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.registration_probe import WORLD, line, session
from helpers.scenes import World
from pretouch_registrar.registration import Registrar, Settings

from pretouch.estimate import Estimate
from pretouch.geometry import Array, Plane, Pose
from pretouch.prior import Prior
from pretouch.scene import Scene
from pretouch.tof import Scan, Sensor
from pretouch.trajectory import Trajectory

REGISTRAR = Registrar()
HALF_ANGLE = float(np.radians(12.5))
DOWN = np.array([0.0, 0.0, -1.0])


def widest(answer: Estimate, prior: Prior) -> float:
    """The largest variance of the answer in any direction, in units of the prior's there."""
    scale = 1.0 / np.sqrt(np.diag(prior.covariance))
    return float(np.linalg.eigvalsh(answer.covariance * np.outer(scale, scale)).max())


def make_scans(case: str, scene: Scene, sensor: Sensor) -> list[Scan]:
    rng = np.random.default_rng(7)
    across = [line((-0.08, -0.01), (0.08, 0.01)), line((0.01, -0.08), (-0.01, 0.08))]

    def scanned(world: World, paths: list[Trajectory]) -> list[Scan]:
        return [world.scanned(path, sensor, rng).beams(sensor) for path in paths]

    def pointing_down(points: Array, ranges: Array) -> list[Scan]:
        origins = points + np.where(np.isnan(ranges), 0.05, ranges)[:, None] * -DOWN
        return [Scan(origins, np.tile(DOWN, (len(points), 1)), ranges)]

    somewhere = scene.centroid + rng.uniform(-0.05, 0.05, (80, 3)) * (1, 1, 0.5)
    match case:
        case "one scan":
            return scanned(WORLD, across[:1])
        case "the flat top":
            return scanned(WORLD, [line((-0.01, 0.0), (0.01, 0.005))])
        case "bare table":
            return scanned(WORLD, [line((-0.08, 0.1), (0.08, 0.1))])
        case "one return":
            return pointing_down(scene.centroid[None], np.array([0.04]))
        case "misses":
            return pointing_down(somewhere, np.full(80, np.nan))
        case "another object":
            return pointing_down(somewhere, np.full(80, 0.04))
        case "far beyond the prior":
            return scanned(WORLD.moved(Pose.of(np.eye(3), (0.035, -0.03, 0.02))), across)
        case "a stuck sensor":
            return [Scan(scan.origins, scan.directions, np.full(len(scan), 0.02)) for scan in scanned(WORLD, across)]
    raise AssertionError(case)


USUAL, TIGHT, LOOSE = Prior(), Prior(0.004, 0.02), Prior(0.03, 0.15)
EVERY = (
    "one scan", "the flat top", "bare table", "one return", "misses", "another object", "far beyond the prior",
    "a stuck sensor",
)  # fmt: skip
CASES = [(case, USUAL) for case in EVERY]
CASES += [(case, prior) for case in ("one scan", "another object", "a stuck sensor") for prior in (TIGHT, LOOSE)]


@pytest.mark.parametrize("half_angle", [0.0, HALF_ANGLE], ids=["thin", "wide"])
@pytest.mark.parametrize(("case", "prior"), CASES)
def test_no_samples_leave_more_uncertain_than_the_prior(case: str, prior: Prior, half_angle: float) -> None:
    scene, _, settings = session(half_angle)
    scans = make_scans(case, scene, settings.sensor)
    answer = REGISTRAR.register(scene, scans, Settings(prior=prior, sensor=settings.sensor))
    assert np.isfinite(answer.covariance).all()
    np.testing.assert_allclose(answer.covariance, answer.covariance.T, atol=1e-15)
    assert np.linalg.eigvalsh(answer.covariance).min() > 0
    assert widest(answer, prior) < 1 + 1e-6


@pytest.mark.parametrize("table", [Plane(np.array([0.0, 0.0, -1.0]), 0.0), Plane(np.array([0.0, 0.0, 1.0]), 2.0)])
def test_an_object_below_the_given_table_is_registered_within_the_prior(table: Plane) -> None:
    scene, scans, settings = session(0.0)
    estimate = REGISTRAR.register(replace(scene, table=table), scans, settings)
    assert np.linalg.eigvalsh(settings.prior.covariance - estimate.covariance).min() > -1e-12
