"""A prior states a mean and a covariance, or is refused with what to do."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from helpers.priors import covariances, means, pose_priors
from hypothesis import given
from hypothesis import strategies as st

from pretouch.errors import InvalidInput, Malformed
from pretouch.estimate import from_prior, point_error
from pretouch.geometry import Pose
from pretouch.prior import PosePrior, Prior
from pretouch.wire.json import prior_from_json
from pretouch.wire.json_objects import object_to_json

CLOUD = np.array([(x, y, z) for x in (0.41, 0.49) for y in (-0.03, 0.03) for z in (0.0, 0.05)])
TIGHT = np.diag([1e-4, 1e-4, 4e-4, 9e-6, 9e-6, 4e-6])


def changed(i: int, j: int, value: float) -> Any:
    covariance = TIGHT.copy()
    covariance[i, j] = value
    return covariance


@given(pose_priors)
def test_before_the_first_scan_the_estimate_is_the_prior(prior: PosePrior) -> None:
    estimate = from_prior(prior, CLOUD)
    assert estimate.base_T_correction.is_close(prior.mean)
    np.testing.assert_array_equal(estimate.covariance, prior.covariance)
    np.testing.assert_allclose(estimate.centroid, CLOUD.mean(axis=0))
    moved = prior.mean.apply(CLOUD)
    expected, quantiles = point_error(prior.covariance, moved, moved.mean(axis=0))
    assert math.isclose(estimate.expected_error, expected, rel_tol=1e-6)
    assert math.isclose(estimate.error_quantile, quantiles[0], rel_tol=1e-6)


@given(means, covariances)
def test_a_covariance_is_kept_and_taken_again_to_the_bit(mean: Pose, covariance: Any) -> None:
    prior = PosePrior(mean, covariance)
    np.testing.assert_allclose(prior.covariance, covariance, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(PosePrior(mean, prior.covariance).covariance, prior.covariance)


@given(st.integers(0, 5), means)
def test_a_direction_that_is_known_exactly_is_known_to_a_hundredth_of_a_millimetre(k: int, mean: Pose) -> None:
    covariance = TIGHT.copy()
    covariance[k, :] = covariance[:, k] = 0.0
    prior = PosePrior(mean, covariance)
    assert np.linalg.eigvalsh(prior.covariance)[0] == pytest.approx(1e-10, rel=1e-3)
    np.testing.assert_array_equal(PosePrior(mean, prior.covariance).covariance, prior.covariance)


@given(st.floats(1e-4, 0.1), st.floats(1e-4, 0.1))
def test_the_standard_deviations_of_an_isotropic_prior_are_those_of_its_axes(shift: float, turn: float) -> None:
    prior = Prior(shift, turn)
    normal = PosePrior(prior.mean, prior.covariance)
    assert normal.translation_std == pytest.approx(shift)
    assert normal.rotation_std == pytest.approx(turn)


@pytest.mark.parametrize(
    ("covariance", "words"),
    [
        (changed(0, 3, 1e-5), r"\[0\]\[3\] is 1e-05, but \[3\]\[0\] is 0"),
        (changed(4, 4, -1e-6), r"\[4\]\[4\] is -1e-06"),
        (changed(2, 2, 1.5), r"\[2\]\[2\] is 1.5"),
        (np.full((6, 6), -1e-4) + 2e-4 * np.eye(6), "has the eigenvalue -4"),
        (np.eye(5), "shape"),
    ],
    ids=["asymmetric", "negative", "too wide", "indefinite", "shape"],
)
def test_what_is_no_covariance_is_refused_with_what_to_do(covariance: Any, words: str) -> None:
    with pytest.raises(InvalidInput, match=words) as caught:
        PosePrior(Pose.identity(), covariance)
    assert "prior.covariance" in caught.value.detail
    assert caught.value.remedy


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_number_that_is_not_finite_is_malformed(value: float) -> None:
    with pytest.raises(Malformed, match=r"prior\.covariance"):
        PosePrior(Pose.identity(), changed(1, 1, value))


def test_a_mean_may_turn_by_45_degrees_and_move_the_object_by_half_a_metre() -> None:
    PosePrior(Pose.from_rotation_vector([0, 0, np.radians(44)], [0, 0, 0]), TIGHT)
    with pytest.raises(InvalidInput, match=r"turns by 46\.0 deg"):
        PosePrior(Pose.from_rotation_vector([0, 0, np.radians(46)], [0, 0, 0]), TIGHT)
    from_prior(PosePrior(Pose.from_rotation_vector([0, 0, 0], [0.49, 0, 0]), TIGHT), CLOUD)
    with pytest.raises(InvalidInput, match=r"moves the object by 0\.51 m"):
        from_prior(PosePrior(Pose.from_rotation_vector([0, 0, 0], [0.51, 0, 0]), TIGHT), CLOUD)


def test_json_has_the_covariance_in_rows_or_in_one_list() -> None:
    prior = PosePrior(Pose.identity(), TIGHT)
    document = object_to_json(prior)
    flat = document | {"covariance": TIGHT.ravel().tolist()}
    for each in (document, flat):
        read = prior_from_json(each)
        np.testing.assert_array_equal(read.covariance, TIGHT)


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ({"covariance": TIGHT.tolist()}, r"prior\.base_T_correction is missing"),
        ({"base_T_correction": {"translation": [0, 0, 0], "rotation": [0, 0, 0, 1]}}, r"prior\.covariance is missing"),
        (object_to_json(PosePrior(Pose.identity(), TIGHT)) | {"rotation_std": 0.1}, "rotation_std is not a known"),
        (object_to_json(PosePrior(Pose.identity(), TIGHT)) | {"covariance": [1.0] * 35}, "35 items, not 6"),
        ({"mean": 1}, "mean is not a known member"),
        ([], "prior is a list"),
    ],
)
def test_json_that_is_no_prior_is_refused(value: object, words: str) -> None:
    with pytest.raises(InvalidInput, match=words):
        prior_from_json(value)
