"""The objective: its derivatives are those of its energy, and a wide beam's hypotheses are averaged."""

import numpy as np
import pytest
from helpers.scenes import KINECT, Box, World
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pretouch_registrar.engines import camera_model, so3
from pretouch_registrar.engines.beam_response import make_cone
from pretouch_registrar.engines.camera_model import CameraModel
from pretouch_registrar.engines.objective import (
    assume_likeliest_hypothesis,
    compute_energies,
    compute_energies_in_parallel,
    compute_energy,
    find_likeliest_hypothesis,
    linearize,
)
from pretouch_registrar.engines.registration_problem import RegistrationProblem, build_problem
from pretouch_registrar.engines.resources import Resources

from pretouch.geometry import Array
from pretouch.prior import Prior
from pretouch.tof import Scan, Sensor

HALF_ANGLE = float(np.radians(12.5))
HYPOTHESES = len(make_cone(HALF_ANGLE).scales)
ARM = 0.05
"""m: a turn by one radian moves the object's points by about as much."""
SCALE = np.array([ARM] * 3 + [1.0] * 3)
BLOCK = World((Box.standing((0.10, 0.08, 0.04)),))
RESOURCES = Resources()
seeds = st.integers(0, 2**16)


@pytest.fixture(scope="module")
def block() -> CameraModel:
    return camera_model.build(BLOCK.scene(KINECT).cropped(0.1)[0])


def downward(model: CameraModel, xy: Array, half_angle: float, rng: np.random.Generator) -> RegistrationProblem:
    """Beams from above the places xy (n, 2), with the noise of a sensor, in which a wide beam is read as a thin one."""
    origins = np.column_stack([xy, np.full(len(xy), 0.085)])
    down = np.tile([0.0, 0.0, -1.0], (len(xy), 1))
    ranges = BLOCK.cast(origins, down)[0] + rng.normal(0, 0.001, len(xy))
    return build_problem(model, [Scan(origins, down, ranges)], Prior(), Sensor(beam_half_angle=half_angle))


def on_planes(rng: np.random.Generator) -> Array:
    """Places (24, 2) on the block's top and on the table beside it, far from the edges of both."""
    top = rng.uniform((-0.03, -0.022), (0.03, 0.022), (12, 2))
    table = rng.uniform((-0.03, 0.07), (0.03, 0.1), (12, 2))
    return np.concatenate([top, table])


def anywhere(rng: np.random.Generator, count: int = 20) -> Array:
    return np.asarray(rng.uniform((-0.08, -0.08), (0.08, 0.08), (count, 2)))


def small(rng: np.random.Generator) -> Array:
    """A correction (6,) of up to half a degree and 2 mm."""
    return np.concatenate([rng.uniform(-0.01, 0.01, 3), rng.uniform(-0.002, 0.002, 3)])


def large(rng: np.random.Generator) -> Array:
    return np.concatenate([rng.uniform(-0.08, 0.08, 3), rng.uniform(-0.018, 0.018, 3)])


def turned_further(x: Array, step: Array) -> Array:
    """x (6,) with a further small turn on the left and a further shift, as the solvers step."""
    return np.concatenate([so3.log(so3.exp(step[:3]) @ so3.exp(x[:3])), x[3:] + step[3:]])


def slopes(problem: RegistrationProblem, x: Array, width: float) -> Array:
    """(6,) one-sided differences of the energy in metres; no example where those of the two sides differ: a kink."""
    here = compute_energy(x, problem)
    steps = width * np.diag(1.0 / SCALE)
    ahead = np.array([compute_energy(turned_further(x, step), problem) - here for step in steps]) / width
    behind = np.array([here - compute_energy(turned_further(x, -step), problem) for step in steps]) / width
    assume(np.linalg.norm(ahead - behind) < 0.02 * np.linalg.norm(ahead))
    return np.asarray(0.5 * (ahead + behind))


@settings(max_examples=30)
@given(seeds)
def test_a_thin_beams_gradient_is_the_slope_of_its_energy(block: CameraModel, seed: int) -> None:
    rng = np.random.default_rng(seed)
    problem, x = downward(block, on_planes(rng), 0.0, rng).without_prior(), small(rng)
    slope = slopes(problem, x, 1e-7)
    _, gradient, energy = linearize(x, problem)
    assert energy == pytest.approx(compute_energy(x, problem), rel=1e-12)
    assert np.linalg.norm(gradient / SCALE - slope) < 0.01 * np.linalg.norm(slope)


@settings(max_examples=30)
@given(seeds, st.integers(0, HYPOTHESES - 1))
def test_a_wide_beams_gradient_is_the_slope_of_its_energy(block: CameraModel, seed: int, hypothesis: int) -> None:
    rng = np.random.default_rng(seed)
    problem = downward(block, on_planes(rng), HALF_ANGLE, rng).without_prior().assume_hypothesis(hypothesis)
    x = small(rng)
    slope = slopes(problem, x, 1e-6)
    _, gradient, energy = linearize(x, problem)
    assert energy == pytest.approx(compute_energy(x, problem), rel=1e-9)
    assert np.linalg.norm(gradient / SCALE - slope) < 0.12 * np.linalg.norm(slope)


@settings(max_examples=30)
@given(seeds, st.sampled_from([0.0, HALF_ANGLE]))
def test_the_priors_part_is_added_to_energy_gradient_and_information(
    block: CameraModel, seed: int, half_angle: float
) -> None:
    rng = np.random.default_rng(seed)
    problem = assume_likeliest_hypothesis(np.zeros(6), downward(block, anywhere(rng), half_angle, rng))
    x = large(rng)
    whole, without = linearize(x, problem), linearize(x, problem.without_prior())
    none = linearize(x, downward(block, np.zeros((0, 2)), 0.0, rng))
    for part in range(3):
        np.testing.assert_allclose(whole[part], without[part] + none[part], rtol=1e-9, atol=1e-6)
    information = whole[0]
    np.testing.assert_allclose(information, information.T, rtol=1e-9)
    assert np.linalg.eigvalsh(information).min() > 0


@settings(max_examples=30)
@given(seeds)
def test_the_energy_is_the_mean_likelihood_of_the_hypotheses(block: CameraModel, seed: int) -> None:
    rng = np.random.default_rng(seed)
    problem, x = downward(block, anywhere(rng), HALF_ANGLE, rng), large(rng)
    single = np.array([compute_energy(x, problem.assume_hypothesis(h)) for h in range(HYPOTHESES)])
    whole = compute_energy(x, problem)
    assert single.min() - 1e-9 <= whole <= single.max() + 1e-9
    assert whole <= single.min() + np.log(HYPOTHESES) + 1e-9
    assert whole == pytest.approx(-np.log(np.mean(np.exp(-single))), abs=1e-6)
    assert single[find_likeliest_hypothesis(x, problem)] == pytest.approx(single.min(), abs=1e-9)


def test_samples_of_one_hypothesis_are_best_explained_by_it_all_together(block: CameraModel) -> None:
    """A module of the shortest pulse reads an edge much nearer than one that weighs near and far alike."""
    x = np.linspace(-0.07, -0.03, 25)
    origins = np.column_stack([x, np.zeros(25), np.full(25, 0.085)])
    down = np.tile([0.0, 0.0, -1.0], (25, 1))
    sensor = Sensor(beam_half_angle=HALF_ANGLE)
    nearest = np.where(np.abs(x + 0.05) < 0.016, 0.045, BLOCK.cast(origins, down)[0])
    problem = build_problem(block, [Scan(origins, down, nearest)], Prior(), sensor)
    lengths = len(problem.cone.decays)
    assert find_likeliest_hypothesis(np.zeros(6), problem) % lengths >= lengths - 2


@settings(max_examples=20)
@given(seeds, st.sampled_from([0.0, HALF_ANGLE]))
def test_the_energy_does_not_depend_on_the_order_of_beams_or_on_threads(
    block: CameraModel, seed: int, half_angle: float
) -> None:
    rng = np.random.default_rng(seed)
    problem = downward(block, anywhere(rng, 60), half_angle, rng)
    order = rng.permutation(60)
    mixed = problem._replace(beams=type(problem.beams)(*(np.ascontiguousarray(b[order]) for b in problem.beams)))
    xs = np.array([large(rng) for _ in range(41)])
    plain = compute_energies(xs, problem)
    np.testing.assert_allclose(compute_energies(xs, mixed), plain, rtol=1e-9)
    np.testing.assert_array_equal(compute_energies_in_parallel(xs, problem, RESOURCES), plain)
    np.testing.assert_array_equal(compute_energies(xs[::-1].copy(), problem)[::-1], plain)


@settings(max_examples=20)
@given(seeds, st.sampled_from([0.0, HALF_ANGLE]))
def test_every_energy_is_finite_and_that_of_samples_is_bounded(
    block: CameraModel, seed: int, half_angle: float
) -> None:
    """The robust kernel: no sample, however absurd, decides alone."""
    rng = np.random.default_rng(seed)
    places = anywhere(rng, 30)
    origins = np.column_stack([places, rng.uniform(0.002, 0.3, 30)])
    directions = rng.normal((0.0, 0.0, -2.0), 1.0, (30, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ranges = np.where(rng.random(30) < 0.2, np.nan, rng.uniform(0.0, 0.3, 30))
    sensor = Sensor(beam_half_angle=half_angle)
    problem = build_problem(block, [Scan(origins, directions, ranges)], Prior(), sensor)
    levels = compute_energies(np.array([large(rng) for _ in range(5)]), problem.without_prior())
    assert np.isfinite(levels).all()
    assert (levels >= 0).all()
    # a sample costs 3.5 at most, and what a spread of paths over a few centimetres or a rim makes uncertain
    assert (levels < 9.0 * problem.beams.weights.sum() / problem.temperature).all()


@settings(max_examples=20)
@given(seeds, st.sampled_from([0.0, HALF_ANGLE]))
def test_a_wrong_height_costs_more_than_the_right_one_and_less_under_wider_noise(
    block: CameraModel, seed: int, half_angle: float
) -> None:
    rng = np.random.default_rng(seed)
    problem = downward(block, on_planes(rng), half_angle, rng).without_prior()
    lifted = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.008])
    assert compute_energy(lifted, problem.widen_noise(4.0)) < compute_energy(lifted, problem)
    assert compute_energy(np.zeros(6), problem) < compute_energy(lifted, problem)
