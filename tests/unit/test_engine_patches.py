"""The effective number of samples that share an error is bounded, however the samples are split."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from pretouch_registrar.engines.camera_noise import CameraNoise
from pretouch_registrar.engines.patches import Patches, SharedError, compute_sample_weights, find_patches, group_samples
from pretouch_registrar.engines.registration_problem import compute_shared_error

from pretouch.geometry import Array, Pose
from pretouch.tof import Sensor

errors = st.builds(
    SharedError,
    own=st.floats(2e-4, 5e-3),
    common=st.floats(2e-4, 5e-3),
    patch=st.sampled_from([0.008, 0.015, 0.02]),
)
seeds = st.integers(0, 2**16)


def samples(seed: int, count: int) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Points within a few patches about the origin, directions and which of the beams returned."""
    rng = np.random.default_rng(seed)
    directions = rng.normal((0.0, 0.0, -4.0), 1.0, (count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return rng.uniform(-0.03, 0.03, (count, 3)), directions, rng.random(count) < 0.7


@given(errors)
def test_the_effective_number_of_a_patch_grows_up_to_a_bound(error: SharedError) -> None:
    effective = error.count_effective(np.array([0.0, 1.0, 2.0, 5.0, 30.0, 1e9]))
    assert effective[0] == 0
    assert effective[1] == pytest.approx(1)
    assert (np.diff(effective) > 0).all()
    bound = 1 + error.own**2 / error.common**2
    assert (effective <= bound * (1 + 1e-12)).all()
    assert effective[-1] == pytest.approx(bound, rel=1e-3)


def test_the_effective_number_is_that_of_the_variance_of_the_mean() -> None:
    error = SharedError(own=0.002, common=0.001, patch=0.01)
    rng = np.random.default_rng(0)
    means = rng.normal(0, error.common, 20_000) + rng.normal(0, error.own, (7, 20_000)).mean(axis=0)
    single = error.own**2 + error.common**2
    assert single / means.var() == pytest.approx(error.count_effective(np.array([7.0]))[0], rel=0.05)


@given(seeds, st.integers(1, 300), errors)
def test_all_samples_of_a_patch_weigh_the_same_and_their_sum_is_the_effective_number(
    seed: int, count: int, error: SharedError
) -> None:
    points, directions, returned = samples(seed, count)
    weights = compute_sample_weights(points, directions, returned, error)
    patches = find_patches(points, directions, returned, error)
    assert patches.counts.sum() == count
    assert weights.sum() == pytest.approx(error.count_effective(patches.counts).sum())
    assert ((weights > 0) & (weights <= 1 + 1e-12)).all()
    cells = np.floor(points[returned] / error.patch)
    for cell in np.unique(cells, axis=0):
        assert np.ptp(weights[returned][(cells == cell).all(axis=1)]) == 0


def weigh(
    points: Array,
    directions: Array,
    returned: NDArray[np.bool_],
    error: SharedError,
    earlier: Patches | None = None,
    each: float = 1.0,
) -> Array:
    """The weights of all samples, each of which stands for `each`, after the earlier ones."""
    every = np.ones((1, len(points)), dtype=bool)
    return group_samples(points, directions, returned, error, earlier).weigh(every, error, np.array([each]))[0]


@given(seeds, st.integers(2, 300), errors)
def test_weights_go_with_the_samples_whatever_their_order(seed: int, count: int, error: SharedError) -> None:
    points, directions, returned = samples(seed, count)
    order = np.random.default_rng(seed).permutation(count)
    mixed = compute_sample_weights(points[order], directions[order], returned[order], error)
    np.testing.assert_array_equal(mixed, compute_sample_weights(points, directions, returned, error)[order])


@given(seeds, st.integers(2, 300), st.floats(0, 1), errors)
def test_a_scan_in_two_parts_tells_as_much_as_in_one(seed: int, count: int, share: float, error: SharedError) -> None:
    points, directions, returned = samples(seed, count)
    first, then = slice(0, round(share * count)), slice(round(share * count), None)
    known = find_patches(points[first], directions[first], returned[first], error)
    before = compute_sample_weights(points[first], directions[first], returned[first], error)
    gain = weigh(points[then], directions[then], returned[then], error, known)
    alone = compute_sample_weights(points[then], directions[then], returned[then], error)
    assert before.sum() + gain.sum() == pytest.approx(compute_sample_weights(points, directions, returned, error).sum())
    assert (gain <= alone + 1e-12).all()
    assert (gain > 0).all()


@given(seeds, st.integers(1, 60), errors)
def test_the_same_samples_again_tell_less_and_elsewhere_as_much_as_ever(
    seed: int, count: int, error: SharedError
) -> None:
    points, directions, returned = samples(seed, count)
    known = find_patches(points, directions, returned, error)
    once = compute_sample_weights(points, directions, returned, error)
    again = weigh(points, directions, returned, error, known)
    assert (again < once).all()
    away = points + np.array([40 * error.patch, 0.0, 0.0])
    np.testing.assert_allclose(
        weigh(away, directions, returned, error, known),
        compute_sample_weights(away, directions, returned, error),
    )
    none = find_patches(points[:0], directions[:0], returned[:0], error)
    np.testing.assert_array_equal(weigh(points, directions, returned, error, none), once)


@given(seeds, st.integers(1, 60), st.integers(1, 9), errors)
def test_a_sample_that_stands_for_several_counts_as_they_would(
    seed: int, count: int, each: int, error: SharedError
) -> None:
    points, directions, returned = samples(seed, count)
    repeated = [np.repeat(values, each, axis=0) for values in (points, directions, returned)]
    standing = weigh(points, directions, returned, error, each=each)
    assert standing.sum() == pytest.approx(compute_sample_weights(*repeated, error).sum())


def test_a_miss_shares_nothing_with_a_return_at_the_same_place() -> None:
    error = SharedError(own=0.001, common=0.002, patch=0.01)
    down = np.array([[0.0, 0.0, -1.0]] * 2)
    starts = np.array([[0.005, 0.005, 0.055], [0.005, 0.005, 0.005]])
    np.testing.assert_allclose(compute_sample_weights(starts, down, np.array([False, True]), error), 1.0)
    assert compute_sample_weights(starts[:1].repeat(2, axis=0), down, np.zeros(2, dtype=bool), error).sum() < 1.5


def test_no_samples_weigh_nothing() -> None:
    none, error = np.zeros((0, 3)), SharedError(0.001, 0.001, 0.01)
    assert compute_sample_weights(none, none, np.zeros(0, dtype=bool), error).shape == (0,)
    assert find_patches(none, none, np.zeros(0, dtype=bool), error).counts.sum() == 0


def test_samples_of_several_modules_share_more_than_those_of_one() -> None:
    one, camera = Sensor(), CameraNoise(pixel=0.001, patch=0.0005)
    several = replace(one, tip_T_module=(Pose.identity(),) * 2)
    assert compute_shared_error(several, camera).common > compute_shared_error(one, camera).common
    assert compute_shared_error(several, camera).own == compute_shared_error(one, camera).own


def test_a_scan_with_a_larger_bias_is_worth_fewer_samples() -> None:
    camera = CameraNoise(pixel=0.001, patch=0.0005)
    worth = [
        compute_shared_error(Sensor(range_bias_std=bias), camera).count_effective(np.array(100.0))
        for bias in (0.0, 0.0007, 0.002)
    ]
    assert worth[0] > worth[1] > worth[2]
