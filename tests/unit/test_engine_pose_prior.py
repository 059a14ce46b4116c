"""Registration with a prior of any mean and covariance, on exact boxes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.predictions import predict_errors
from helpers.priors import covariance_of, covariances
from helpers.registration_probe import TRUTH, line, session
from hypothesis import given
from hypothesis import strategies as st
from pretouch_registrar.engines import Engine
from pretouch_registrar.engines.covariance_inflation import inflate
from pretouch_registrar.engines.prior import (
    FALL_OFF_SIGMAS,
    FLAT_COST_SHARE,
    FLAT_SIGMAS,
    CorrectionPrior,
    add_prior,
    compute_prior_cost,
)
from pretouch_registrar.registration import Registrar, Settings

from pretouch.errors import InvalidInput
from pretouch.estimate import Estimate
from pretouch.geometry import Array, Pose, vector_from_rotation
from pretouch.prior import AnyPrior, PosePrior, Prior
from pretouch.scene import Scene
from pretouch.tof import Scan

REGISTRAR = Registrar()
SCENE, SCANS, SETTINGS = session(0.0)
STDS = np.array([0.01, 0.01, 0.01, 0.003, 0.003, 0.003])
NEAR_TRUTH = Pose.from_rotation_vector((0.004, -0.003, 0.006), (0.001, 0.0015, -0.001)) @ TRUTH
numbers = st.floats(-3, 3, allow_subnormal=False)


def register(prior: AnyPrior, scans: list[Scan], scene: Scene = SCENE, engine: Engine = Engine.POSTERIOR) -> Estimate:
    return REGISTRAR.register(scene, scans, Settings(engine, prior, SETTINGS.sensor))


def error_of(estimate: Estimate) -> float:
    """m, the mean over the object's points."""
    cloud = SCENE.cloud
    return float(np.linalg.norm(estimate.base_T_correction.apply(cloud) - TRUTH.apply(cloud), axis=1).mean())


def widest(covariance: Array, bound: Array) -> float:
    """The largest variance in any direction, in units of the bound's there."""
    whiten = np.linalg.inv(np.linalg.cholesky(bound))
    return float(np.linalg.eigvalsh(whiten @ covariance @ whiten.T)[-1])


def narrowest(covariance: Array, bound: Array) -> float:
    """The least variance in any direction, in units of the bound's there."""
    return 1 / widest(bound, covariance)


def apart(a: Pose, b: Pose) -> float:
    """rad and m at the object's centroid, the larger one."""
    turn = np.abs(vector_from_rotation(a.rotation @ b.rotation.T)).max()
    return float(max(turn, np.abs(a.apply(SCENE.centroid) - b.apply(SCENE.centroid)).max()))


@given(st.tuples(*[numbers] * 6), st.floats(1e-3, 0.1), st.floats(1e-3, 0.1))
def test_the_flat_cost_is_the_sum_over_the_components(sigmas: tuple[float, ...], shift: float, turn: float) -> None:
    prior = CorrectionPrior.of(Prior(shift, turn))
    z = np.array(sigmas)
    x = z * np.repeat([turn, shift], 3)
    beyond = np.maximum(np.abs(z) - FLAT_SIGMAS, 0.0) / FALL_OFF_SIGMAS
    assert compute_prior_cost(x, prior) == pytest.approx(0.5 * (FLAT_COST_SHARE * z**2 + beyond**2).sum(), abs=1e-9)
    information, gradient = np.zeros((6, 6)), np.zeros(6)
    add_prior(x, prior, information, gradient)
    np.testing.assert_array_equal(information, np.diag(np.diag(information)))
    slope = (FLAT_COST_SHARE * z + np.sign(z) * beyond / FALL_OFF_SIGMAS) / np.repeat([turn, shift], 3)
    np.testing.assert_allclose(gradient, slope, atol=1e-9 / shift)


@given(st.tuples(*[numbers] * 6), covariances)
def test_the_normal_cost_is_half_the_squared_mahalanobis_distance(sigmas: tuple[float, ...], covariance: Array) -> None:
    stated = PosePrior(Pose.identity(), covariance)
    prior = CorrectionPrior.of(stated)
    x = prior.root @ np.array(sigmas)
    assert compute_prior_cost(x, prior) == pytest.approx(0.5 * np.square(sigmas).sum(), rel=1e-6, abs=1e-9)
    information, gradient = np.zeros((6, 6)), np.zeros(6)
    add_prior(x, prior, information, gradient)
    np.testing.assert_allclose(information, prior.precision, rtol=1e-6, atol=1e-9 * np.abs(prior.precision).max())
    np.testing.assert_allclose(gradient, prior.precision @ x, rtol=1e-5, atol=1e-7 * np.abs(gradient).max())
    assert compute_prior_cost(x, prior.removed()) == 0


@given(covariances, covariances, st.floats(0.1, 1))
def test_a_bounded_covariance_is_in_no_direction_wider(covariance: Array, bound: Array, most: float) -> None:
    prior = CorrectionPrior.of(PosePrior(Pose.identity(), bound))
    assert widest(prior.bound(covariance, most), prior.covariance) < most * (1 + 1e-6)
    inside = 0.5 * most * prior.covariance
    np.testing.assert_allclose(prior.bound(inside, most), inside, rtol=1e-5, atol=1e-9 * inside.max())


@pytest.mark.parametrize("engine", [Engine.POSTERIOR, Engine.POINT_TO_PLANE])
def test_a_good_prior_leaves_a_smaller_error_and_no_wider_covariance(engine: Engine) -> None:
    prior = PosePrior(NEAR_TRUTH, np.diag(STDS**2))
    for count in (1, 2):
        usual, told = (register(each, SCANS[:count], engine=engine) for each in (Prior(), prior))
        assert widest(told.covariance, prior.covariance) < 1 + 1e-6
        assert told.expected_error < usual.expected_error
        assert error_of(told) < error_of(usual) + 5e-4
    assert error_of(told) < 0.003


def test_a_normal_prior_of_the_usual_size_answers_like_the_usual_one() -> None:
    usual = register(Prior(), SCANS)
    normal = register(PosePrior(Pose.identity(), Prior().covariance), SCANS)
    assert apart(usual.base_T_correction, normal.base_T_correction) < 0.005
    assert 0.5 < normal.expected_error / usual.expected_error < 1.3


@pytest.mark.parametrize("motion", [(0.0, 0.0, 0.3, 0.05, -0.08, 0.0), (0.2, -0.1, 0.1, 0.0, 0.05, 0.06)])
def test_a_camera_that_is_moved_and_a_mean_that_moves_it_back_change_nothing(motion: tuple[float, ...]) -> None:
    believed = Pose.from_rotation_vector(motion[:3], motion[3:])
    prior = PosePrior(NEAR_TRUTH, covariance_of(STDS, np.random.default_rng(0).uniform(-1, 1, (6, 6))))
    moved = replace(prior, base_T_correction=NEAR_TRUTH @ believed.inverse())
    first = register(prior, SCANS[:2])
    other = register(moved, SCANS[:2], SCENE.moved(believed))
    assert apart(first.base_T_correction, other.base_T_correction @ believed) < 3e-4
    np.testing.assert_allclose(other.centroid, believed.apply(first.centroid), atol=1e-9)
    assert other.expected_error == pytest.approx(first.expected_error, rel=0.1)
    paths = [line((-0.07, 0.05), (0.07, -0.04)), line((0.03, -0.07), (0.03, 0.07))]
    predicted = [
        predict_errors(REGISTRAR, scene, SCANS[:2], Settings(prior=each, sensor=SETTINGS.sensor), paths)
        for scene, each in ((SCENE, prior), (SCENE.moved(believed), moved))
    ]
    np.testing.assert_allclose(*predicted, rtol=0.1)


@pytest.mark.parametrize("count", [1, 2, len(SCANS)])
def test_samples_that_tell_nothing_beyond_a_prior_do_not_make_it_surer(count: int) -> None:
    prior = PosePrior(TRUTH, np.diag(np.full(6, 1e-5) ** 2))
    answer = register(prior, SCANS[:count])
    assert narrowest(answer.covariance, prior.covariance) > 0.95


@given(covariances, st.lists(st.floats(0.0, 1.0), min_size=6, max_size=6), st.floats(0.3, 3.0))
def test_a_factor_acts_on_what_samples_add_to_a_normal_prior(stated: Array, shares: list[float], factor: float) -> None:
    prior = CorrectionPrior.of(PosePrior(Pose.identity(), stated))
    left = (prior.root * np.array(shares)) @ prior.root.T
    inflated = np.diag(prior.whiten @ inflate(left, factor, prior) @ prior.whiten.T)
    for share, found in zip(shares, inflated, strict=True):
        within = 1 if share == 1 else 1 / (1 + (1 / share - 1) / factor**2) if share else 0
        assert found == pytest.approx(within if factor < 1 else factor**2 * share, rel=1e-4, abs=1e-6)


@pytest.mark.parametrize(
    "stds",
    [np.full(6, 1e-4), STDS * (1, 1, 1, 0.3, 0.3, 7), STDS * (1, 1, 8, 1, 1, 0.001), STDS * (1, 1, 0, 1, 0, 1)],
    ids=["tight", "height unknown", "yaw unknown", "known exactly"],
)
def test_directions_may_be_known_better_than_others(stds: Array) -> None:
    offset = np.random.default_rng(2).standard_normal(6) * np.maximum(stds, 1e-5)
    turned = Pose.from_rotation_vector(offset[:3], np.zeros(3)).rotation @ TRUTH.rotation
    mean = Pose.of(turned, TRUTH.apply(SCENE.centroid) + offset[3:] - turned @ SCENE.centroid)
    prior = PosePrior(mean, np.diag(stds**2))
    for scans in (SCANS[:1], SCANS):
        answer = register(prior, scans)
        assert np.isfinite(answer.covariance).all()
        assert widest(answer.covariance, prior.covariance) < 1 + 1e-6
        told = PosePrior(answer.base_T_correction, answer.covariance)
        assert not told.is_contradicted_by(TRUTH, SCENE.centroid, np.zeros((6, 6)))
    assert error_of(answer) < 0.006


@pytest.mark.parametrize("std", [1e-4, 1e-3])
def test_a_confident_wrong_prior_is_found_out(std: float) -> None:
    wrong = Pose.from_rotation_vector((0, 0, 0), (-0.012, 0.01, 0.0)) @ TRUTH
    prior = PosePrior(wrong, np.diag(np.array([2 * std] * 3 + [std] * 3) ** 2))
    answer = register(prior, SCANS)
    assert prior.is_contradicted_by(answer.base_T_correction, answer.centroid, answer.covariance)
    assert error_of(answer) < 0.004
    right = register(replace(prior, base_T_correction=TRUTH), SCANS)
    assert not prior.is_contradicted_by(wrong, right.centroid, right.covariance)


def test_nearly_equal_priors_are_not_taken_for_each_other() -> None:
    covariance = np.diag(STDS**2)
    first, second = (Settings(prior=PosePrior(NEAR_TRUTH, scale * covariance)) for scale in (1.0, 1.0 + 1e-12))
    assert repr(first) == repr(second)
    assert first.digest != second.digest
    assert Settings(prior=Prior()).digest != Settings(prior=PosePrior(Pose.identity(), Prior().covariance)).digest


def test_a_mean_that_moves_the_object_too_far_is_refused() -> None:
    prior = PosePrior(Pose.from_rotation_vector((0, 0, 0), (0.6, 0, 0)), np.diag(STDS**2))
    with pytest.raises(InvalidInput, match=r"moves the object by 0\.6 m"):
        register(prior, SCANS)
