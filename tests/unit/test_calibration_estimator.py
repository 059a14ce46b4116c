"""What a camera's sessions together say about its calibration."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.camera_sessions import camera_at, campaign, draw_errors, session, turned
from hypothesis import given, settings
from hypothesis import strategies as st
from pretouch_orchestrator.calibration import Observation, estimate_calibration
from pretouch_orchestrator.calibration.assumptions import MAX_OBSERVATIONS
from pretouch_orchestrator.calibration.observation import difference

from pretouch.geometry import Array, Pose
from pretouch.prior import PosePrior, Prior

CENTROID = np.array([0.03, -0.02, 0.05])
CHI2_95 = 12.592
seeds = st.integers(0, 2**32 - 1)
few = settings(max_examples=8, deadline=None)


def _chi2(prior: PosePrior, truth: Pose, centroid: Array) -> float:
    off = difference(truth, prior.mean, centroid)
    return float(off @ np.linalg.solve(prior.covariance, off))


def test_nothing_is_known_without_sessions() -> None:
    calibration = estimate_calibration([])
    assert calibration.count == 0
    assert calibration.predict(camera_at(0.0), CENTROID) is None
    assert calibration.correct(camera_at(0.3)).is_close(camera_at(0.3))


@few
@given(seeds)
def test_one_session_is_finite_and_narrower_than_the_default(seed: int) -> None:
    seen = campaign(np.random.default_rng(seed), 1, 0.5)
    prior = estimate_calibration(seen).predict(seen[0].base_T_camera, seen[0].centroid)
    assert prior is not None
    assert np.isfinite(prior.covariance).all()
    assert np.trace(np.linalg.solve(Prior().covariance, prior.covariance)) < 6


@few
@given(seeds, st.integers(2, 7))
def test_the_order_of_the_sequence_does_not_matter(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    seen = campaign(rng, count, 0.6)
    first, second = estimate_calibration(seen), estimate_calibration([seen[k] for k in rng.permutation(count)])
    assert np.array_equal(first.covariance, second.covariance)
    assert np.array_equal(first.camera_T_camera.matrix, second.camera_T_camera.matrix)


@few
@given(seeds)
def test_another_base_frame_changes_nothing_but_the_frame(seed: int) -> None:
    rng = np.random.default_rng(seed)
    seen = campaign(rng, 5, 0.6)
    move = Pose.from_rotation_vector(rng.normal(size=3), rng.normal(size=3))
    first, second = estimate_calibration(seen), estimate_calibration([_moved(move, one) for one in seen])
    assert second.camera_T_camera.is_close(first.camera_T_camera, 1e-6)
    assert second.base_T_base.is_close(move @ first.base_T_base @ move.inverse(), 1e-6)
    camera = camera_at(0.2)
    here, there = first.predict(camera, CENTROID), second.predict(move @ camera, move.apply(CENTROID))
    assert here is not None
    assert there is not None
    turns = np.kron(np.eye(2), move.rotation)
    assert np.allclose(turns @ here.covariance @ turns.T, there.covariance, rtol=1e-4, atol=1e-10)


def _moved(move: Pose, seen: Observation) -> Observation:
    turns = np.kron(np.eye(2), move.rotation)
    return Observation(
        seen.session_id,
        seen.at,
        move @ seen.base_T_camera,
        move @ seen.base_T_correction @ move.inverse(),
        move.apply(seen.centroid),
        turns @ seen.covariance @ turns.T,
        move @ seen.prior_mean @ move.inverse(),
        turns @ seen.prior_covariance @ turns.T,
    )


def test_both_sides_are_told_apart_by_cameras_all_around() -> None:
    rng = np.random.default_rng(1)
    errors = draw_errors(rng)
    seen = []
    for k in range(14):
        camera = camera_at(rng.uniform(-np.pi, np.pi), rng.uniform(0.6, 1.2))
        camera = camera @ Pose.from_rotation_vector(rng.normal(size=3) * 0.2, np.zeros(3))
        seen.append(session(k, camera, errors[1] @ camera @ errors[0], np.append(rng.uniform(-0.2, 0.2, 2), 0.05)))
    calibration = estimate_calibration(seen)
    assert calibration.count == 14
    off = difference(errors[0], calibration.camera_T_camera, np.array([0.0, 0.0, 0.9]))
    assert np.linalg.norm(off[:3]) < 0.01
    assert np.linalg.norm(off[3:]) < 0.004
    off = difference(errors[1], calibration.base_T_base, CENTROID)
    assert np.linalg.norm(off[:3]) < 0.01
    assert np.linalg.norm(off[3:]) < 0.004


def test_a_fixed_camera_tells_the_sum_of_both_sides_but_not_each() -> None:
    errors = draw_errors(np.random.default_rng(2))
    calibration = estimate_calibration(campaign(np.random.default_rng(3), 8, 0.0, errors))
    camera = camera_at(0.0)
    prior = calibration.predict(camera, CENTROID)
    assert prior is not None
    assert _chi2(prior, errors[1] @ camera @ errors[0] @ camera.inverse(), CENTROID) < CHI2_95
    assert prior.translation_std < 0.004
    assert np.sqrt(np.diag(calibration.covariance)[:3].max()) > 0.02


@few
@given(seeds)
def test_the_prediction_narrows_with_sessions(seed: int) -> None:
    seen = campaign(np.random.default_rng(seed), 8, 0.4)
    widths = []
    for count in (1, 3, 8):
        prior = estimate_calibration(seen[:count]).predict(camera_at(0.0), CENTROID)
        assert prior is not None
        widths.append(np.trace(np.linalg.solve(Prior().covariance, prior.covariance)))
    assert widths[0] > widths[1] > widths[2]


def test_the_truth_lies_in_the_predicted_region() -> None:
    held = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        errors = draw_errors(rng)
        seen = campaign(rng, 5, 0.5, errors)
        prior = estimate_calibration(seen[:4]).predict(seen[4].base_T_camera, seen[4].centroid)
        assert prior is not None
        own = turned(rng.normal(size=3) * 0.0035, rng.normal(size=3) * 0.001, np.array([0.0, 0.0, 0.9]))
        camera = seen[4].base_T_camera
        held.append(_chi2(prior, errors[1] @ camera @ errors[0] @ own @ camera.inverse(), seen[4].centroid) < CHI2_95)
    assert np.mean(held) >= 0.8


def test_sessions_better_than_they_state_do_not_make_rotations_sure() -> None:
    """They hide how much differs from session to session: 2 mm and 0.4 deg, where each states 1 mm and 0.6 deg."""
    squares = []
    for seed in range(24):
        rng = np.random.default_rng(seed)
        (camera_error, base_error), seen = draw_errors(rng), list[Observation]()
        for k in range(12):
            camera, centroid = camera_at(rng.uniform(-0.8, 0.8)), np.append(rng.uniform(-0.1, 0.1, 2), 0.05)
            in_camera = camera.inverse().apply(centroid)
            residual = turned(rng.normal(size=3) * 0.007, rng.normal(size=3) * 0.002, in_camera)
            own = turned(rng.normal(size=3) * 0.005, rng.normal(size=3) * 0.0005, in_camera)
            true_camera = base_error @ camera @ camera_error @ residual
            if k in (8, 11):
                prior = estimate_calibration(seen).predict(camera, centroid)
                assert prior is not None
                turn = difference(true_camera @ camera.inverse(), prior.mean, centroid)[:3]
                squares.append(turn @ np.linalg.solve(prior.covariance[:3, :3], turn) / 3)
            seen.append(session(k, camera, true_camera @ own, centroid))
    assert np.sqrt(np.mean(squares)) < 1.25


def test_only_the_latest_of_many_sessions_are_looked_at() -> None:
    seen = campaign(np.random.default_rng(4), MAX_OBSERVATIONS, 0.5)
    older = [
        Observation(
            f"old-{k:05d}",
            -1.0 - k,
            one.base_T_camera,
            one.base_T_correction,
            one.centroid,
            one.covariance,
            one.prior_mean,
            one.prior_covariance,
        )
        for k in range(10_000 - MAX_OBSERVATIONS)
        for one in (seen[k % 7],)
    ]
    with_older, without = estimate_calibration(older + seen), estimate_calibration(seen)
    assert np.array_equal(with_older.covariance, without.covariance)


def test_sessions_at_one_time_are_taken_by_their_names() -> None:
    seen = [
        Observation(
            one.session_id,
            0.0,
            one.base_T_camera,
            one.base_T_correction,
            one.centroid,
            one.covariance,
            one.prior_mean,
            one.prior_covariance,
        )
        for one in campaign(np.random.default_rng(5), 4, 0.5)
    ]
    first, second = estimate_calibration(seen), estimate_calibration(seen[::-1])
    assert np.array_equal(first.covariance, second.covariance)


@pytest.mark.parametrize("far", [1.0, 30.0])
def test_a_camera_that_jumps_far_is_predicted_no_narrower_than_its_sides_allow(far: float) -> None:
    errors = draw_errors(np.random.default_rng(6))
    calibration = estimate_calibration(campaign(np.random.default_rng(7), 8, 0.3, errors))
    camera = Pose.of(camera_at(np.pi).rotation, camera_at(np.pi).translation + np.array([0.0, 0.0, far]))
    prior = calibration.predict(camera, CENTROID)
    if prior is not None:
        assert _chi2(prior, errors[1] @ camera @ errors[0] @ camera.inverse(), CENTROID) < CHI2_95
