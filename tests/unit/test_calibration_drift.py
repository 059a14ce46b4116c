"""Wrong sessions, knocks and cameras that are not what they say."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.camera_sessions import camera_at, campaign, draw_errors, session, turned
from pretouch_orchestrator.calibration import estimate_calibration
from pretouch_orchestrator.calibration.observation import difference

from pretouch.geometry import Array, Pose
from pretouch.prior import Prior

CENTROID = np.array([0.0, 0.0, 0.05])
IN_CAMERA = np.array([0.0, 0.0, 0.9])


def _later(count: int, start: int, errors: tuple[Pose, Pose], shift: Array) -> list[object]:
    seen = []
    for k in range(start, start + count):
        camera = camera_at(0.1 * (k % 4))
        moved = turned(np.zeros(3), shift, IN_CAMERA) @ errors[0]
        seen.append(session(k, camera, errors[1] @ camera @ moved, CENTROID))
    return seen


def _chi2(calibration: object, camera: Pose, truth: Pose) -> float:
    prior = calibration.predict(camera, CENTROID) or Prior()
    off = difference(truth, prior.mean, CENTROID)
    return float(off @ np.linalg.solve(prior.covariance, off))


@pytest.mark.parametrize("seed", range(3))
def test_one_wrong_session_is_suspected_then_left_out(seed: int) -> None:
    errors = draw_errors(np.random.default_rng(seed))
    seen = campaign(np.random.default_rng(seed + 100), 5, 0.3, errors) + _later(
        1, 5, errors, np.array([0.03, 0.0, 0.0])
    )
    calibration = estimate_calibration(seen)
    assert (calibration.drift.state, calibration.drift.since) == ("suspected", "s0005")
    calibration = estimate_calibration(seen + _later(3, 6, errors, np.zeros(3)))
    assert calibration.drift.state == "steady"
    assert list(calibration.rejected) == ["s0005"]
    camera = camera_at(0.1)
    assert _chi2(calibration, camera, errors[1] @ camera @ errors[0] @ camera.inverse()) < 12.6


def test_a_first_wrong_session_is_left_out() -> None:
    errors = draw_errors(np.random.default_rng(0))
    seen = _later(1, 0, errors, np.array([0.0, 0.03, 0.0])) + _later(4, 1, errors, np.zeros(3))
    calibration = estimate_calibration(seen)
    assert list(calibration.rejected) == ["s0000"]
    assert calibration.drift.state == "steady"


@pytest.mark.parametrize("seed", range(3))
def test_a_knock_is_told_by_the_second_session_and_forgotten(seed: int) -> None:
    errors = draw_errors(np.random.default_rng(seed))
    before = campaign(np.random.default_rng(seed + 100), 6, 0.3, errors)
    shift = np.array([0.0, 0.025, 0.0])
    after = _later(10, 6, errors, shift)
    known, first = estimate_calibration(before), estimate_calibration(before + after[:1])
    camera = camera_at(0.1)
    narrow, wide = (one.predict(camera, CENTROID) or Prior() for one in (known, first))
    assert wide.translation_std > 1.3 * narrow.translation_std
    second = estimate_calibration(before + after[:2])
    assert (second.drift.state, second.drift.since) == ("moved", "s0006")
    assert set(second.rejected) == {one.session_id for one in before}
    truth = errors[1] @ camera @ turned(np.zeros(3), shift, IN_CAMERA) @ errors[0] @ camera.inverse()
    assert _chi2(second, camera, truth) < 12.6
    assert estimate_calibration(before + after).drift.state == "steady"


@pytest.mark.parametrize("seed", range(3))
def test_a_camera_that_wobbles_about_its_origin_was_not_knocked(seed: int) -> None:
    """0.4 deg about the camera move the objects by 6 mm, across the line of sight and never along it."""
    errors, rng = draw_errors(np.random.default_rng(seed)), np.random.default_rng(seed + 100)
    seen = []
    for k in range(12):
        camera, wobble = camera_at(0.1 * (k % 4)), turned(rng.normal(size=3) * 0.007, np.zeros(3), np.zeros(3))
        seen.append(session(k, camera, errors[1] @ camera @ errors[0] @ wobble, CENTROID))
        calibration = estimate_calibration(seen)
        assert calibration.drift.state != "moved"
    across, along = np.diag(calibration.residual)[3:5].mean(), calibration.residual[5, 5]
    assert along < 0.2 * across
    assert 0.004 < np.sqrt(across) < 0.009


def test_two_cameras_under_one_id_give_no_confident_prior() -> None:
    errors = draw_errors(np.random.default_rng(3))
    shifts = [np.zeros(3), np.array([0.02, 0.015, 0.0])]
    seen = [_later(1, k, errors, shifts[k % 2])[0] for k in range(10)]
    camera = camera_at(0.0)
    for count in (6, 7, 8, 9, 10):
        calibration = estimate_calibration(seen[:count])
        for shift in shifts:
            truth = errors[1] @ camera @ turned(np.zeros(3), shift, IN_CAMERA) @ errors[0] @ camera.inverse()
            assert _chi2(calibration, camera, truth) < 12.6


def test_another_pose_declared_for_a_fixed_camera_is_another_error() -> None:
    errors = draw_errors(np.random.default_rng(4))
    seen = campaign(np.random.default_rng(5), 4, 0.0, errors)
    calibration = estimate_calibration(seen)
    assert calibration.predict(camera_at(0.0), CENTROID) is not None
    assert calibration.predict(camera_at(0.05), CENTROID) is None


def test_sessions_that_add_nothing_do_not_count() -> None:
    one = campaign(np.random.default_rng(6), 1, 0.0)[0]
    nothing = type(one)(
        one.session_id,
        one.at,
        one.base_T_camera,
        Pose.identity(),
        one.centroid,
        one.prior_covariance,
        one.prior_mean,
        one.prior_covariance,
    )
    calibration = estimate_calibration([nothing])
    assert calibration.count == 0
    assert list(calibration.rejected) == [one.session_id]
    assert calibration.predict(one.base_T_camera, one.centroid) is None
