"""The parts of engine `posterior` against exact results, and its modes where two poses explain the samples."""

import numpy as np
import pytest
from helpers.scenes import KINECT, Box, World
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_registrar.engines.prior import CorrectionPrior
from pretouch_registrar.engines.solvers import importance, smc
from pretouch_registrar.engines.solvers.importance import Mode
from pretouch_registrar.registration import Registrar, Settings

from pretouch.geometry import Array
from pretouch.prior import Prior
from pretouch.scene import Scene
from pretouch.tof import Scan, Sensor
from pretouch.trajectory import Trajectory

REGISTRAR = Registrar()
UNIT = CorrectionPrior.of(Prior(1.0, 1.0))


def mixture(xs: Array, places: Array, std: float) -> Array:
    """Negative logarithms (m,) of a mixture of equal round normals at `places` (k, 6)."""
    squared = ((xs[:, None] - places[None]) ** 2).sum(axis=2) / std**2
    return np.asarray(-np.log(np.exp(-0.5 * squared).sum(axis=1) + 1e-300))


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**16), st.floats(0.1, 0.8), st.floats(0.7, 1.5))
def test_moments_of_two_places_are_those_of_their_mixture(seed: int, std: float, wrong: float) -> None:
    rng = np.random.default_rng(seed)
    places = rng.uniform(-1, 1, (2, 6))
    modes = [Mode(place, (wrong * std) ** 2 * np.eye(6), 0.5) for place in places]
    mean, covariance = importance.estimate_moments(lambda x: mixture(x, places, std), modes)
    apart = 0.5 * (places[0] - places[1])
    np.testing.assert_allclose(mean, places.mean(axis=0), atol=0.25 * (std + np.linalg.norm(apart)))
    expected = std**2 * np.eye(6) + np.outer(apart, apart)
    np.testing.assert_allclose(np.trace(covariance), np.trace(expected), rtol=0.35)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**16))
def test_the_search_finds_a_narrow_place_anywhere_in_the_prior(seed: int) -> None:
    place = np.random.default_rng(seed).uniform(-1.7, 1.7, (1, 6))
    xs, level = smc.sample_population(lambda x, factor: mixture(x, place, 0.15 * factor), UNIT)
    assert np.linalg.norm(xs[level.argmin()] - place[0]) < 0.3
    assert np.median(np.linalg.norm(xs - place[0], axis=1)) < 0.6


PITCH = 0.014


def comb() -> World:
    """Six ridges of one object, all alike."""
    return World(tuple(Box.standing((0.007, 0.06, 0.025), ((k - 2.5) * PITCH, 0.0)) for k in range(6)))


@pytest.fixture(scope="module")
def ridges() -> Scene:
    depth, _ = comb().depth(KINECT, np.random.default_rng(1))
    whole = comb().scene(KINECT)
    points = whole.base_T_camera.apply(whole.camera.back_project_image(depth.metres))
    mask = (points[..., 2] > 0.006) & (np.abs(points[..., :2]).max(axis=2) < 0.06)
    return Scene(depth, whole.camera, whole.base_T_camera, mask, whole.table).cropped(0.08)[0]


def across(start: tuple[float, float], end: tuple[float, float]) -> Scan:
    tip = np.tile(np.eye(4), (2, 1, 1))
    tip[:, :3, :3] = np.diag([1.0, -1.0, -1.0])
    tip[:, :2, 3] = start, end
    tip[:, 2, 3] = 0.06
    path = Trajectory(np.array([0.0, np.linalg.norm(np.subtract(end, start)) / 0.05]), tip)
    return comb().scanned(path, Sensor(), np.random.default_rng(2)).beams(Sensor())


def test_a_scan_that_cannot_tell_ridges_apart_is_said_to_fit_several_places(ridges: Scene) -> None:
    inside = [across((-0.02, 0.005), (0.02, -0.005)), across((-0.015, -0.02), (0.02, 0.02))]
    answer = REGISTRAR.register(ridges, inside, Settings())
    assert len(answer.modes) > 1
    assert sum(mode.weight for mode in answer.modes) == pytest.approx(1)
    assert answer.modes[0].base_T_correction.is_close(answer.base_T_correction)
    assert answer.error_quantile > 0.7 * PITCH
    over_the_ends = [across((-0.08, 0.01), (0.08, 0.0)), across((0.007, -0.06), (0.007, 0.06))]
    answer = REGISTRAR.register(ridges, inside + over_the_ends, Settings())
    assert answer.expected_error < 0.5 * PITCH
    assert np.linalg.norm(answer.base_T_correction.apply(ridges.centroid) - ridges.centroid) < 0.004
