"""Which sessions count for their camera, in which order, and what is said of a camera that may have moved."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.camera_ends import camera_record, converged, counted
from hypothesis import given
from hypothesis import strategies as st
from pretouch_orchestrator.calibration import Calibration
from pretouch_orchestrator.cameras.findings import (
    describe_camera,
    describe_event,
    find_reason,
    list_observations,
    observe,
    predict_prior,
    warn_of_drift,
)
from pretouch_orchestrator.sessions.endings import end_session
from pretouch_orchestrator.store.protocol import CameraEntry, CameraMemory

from pretouch.calibrated_camera import CalibrationDrift
from pretouch.errors import Internal, InvalidInput, problem
from pretouch.exhaustion import Exhaustion, exhaustion_problem
from pretouch.geometry import Pose
from pretouch.prior import PosePrior
from pretouch.session import State


def test_a_session_that_converged_counts_with_what_it_found() -> None:
    record = converged(camera_record("one"))
    record = replace(record, request=replace(record.request, prior=None))
    assert find_reason(record) == ""
    entry = observe(record, 5.0)
    found = entry.observation
    assert found is not None
    assert (entry.reason, found.session_id, found.at) == ("", "one", 5.0)
    assert found.base_T_correction.is_close(record.estimate.base_T_correction)
    assert found.prior_mean.is_close(Pose.identity())
    np.testing.assert_allclose(found.prior_covariance, record.prior.covariance)
    cloud = record.scene.cloud
    moved = np.linalg.norm(record.estimate.base_T_correction.apply(cloud) - cloud, axis=1).mean()
    assert entry.error == pytest.approx(moved)
    assert entry.expected_error > entry.error / 10


def test_a_prior_that_the_samples_contradicted_is_not_taken_for_the_one_that_was_used() -> None:
    narrow = PosePrior(Pose.identity(), np.diag([1e-6] * 6))
    record = converged(camera_record("one"))
    record = replace(record, request=replace(record.request, prior=narrow))
    agreeing = replace(record.estimate, base_T_correction=Pose.identity(), modes=())
    for estimate, used in ((record.estimate, narrow.fallback), (agreeing, narrow)):
        found = observe(replace(record, estimate=replace(estimate, covariance=narrow.covariance)), 1.0).observation
        assert found is not None
        np.testing.assert_allclose(found.prior_covariance, used.covariance)


@pytest.mark.parametrize("cause", list(Exhaustion))
def test_an_exhausted_session_counts_if_it_is_honest(cause: Exhaustion) -> None:
    ended = end_session(
        replace(converged(camera_record("one")), state=State.AWAITING_SCAN),
        State.EXHAUSTED,
        exhaustion_problem(cause, "It is spent.", "Wait."),
    )
    honest = cause in ("scans", "seconds", "fraction", "nothing-to-gain")
    assert (find_reason(ended) == "") == honest
    assert (observe(ended, 1.0).observation is not None) == honest


@pytest.mark.parametrize(
    "changes",
    [
        {"state": State.CANCELLED},
        {"state": State.FAILED, "reason": problem(Internal("a defect", "report it"))},
        {"scans": ()},
        {"state": State.EXHAUSTED, "reason": {"type": "urn:pretouch:problem:of-tomorrow"}},
        {"state": State.EXHAUSTED, "reason": None},
    ],
)
def test_a_session_that_failed_or_never_scanned_does_not_count_and_says_why(changes: dict[str, Any]) -> None:
    ended = replace(converged(camera_record("one")), **changes)
    entry = observe(ended, 1.0)
    assert entry.observation is None
    assert entry.reason.endswith(".")


def test_without_a_return_nothing_was_found() -> None:
    record = converged(camera_record("one"))
    assert find_reason(replace(record, estimate=replace(record.estimate, samples=0)))


@given(st.lists(st.floats(0, 4e9), min_size=1, max_size=20))
def test_a_clock_that_jumps_leaves_the_order_of_sessions_as_it_was(clock: list[float]) -> None:
    entries = [counted(f"s{k}", 0, at).entry for k, at in enumerate(clock)]
    observed = list_observations(entries)
    assert [each.session_id for each in observed] == [entry.session_id for entry in entries]
    assert all(a.at < b.at for a, b in itertools.pairwise(observed))
    assert observed[0].at == clock[0]
    assert all(each.at >= at for each, at in zip(observed, clock, strict=True))


class Wild(Calibration):
    """Predicts what is no prior."""

    def predict(self, base_T_camera: Pose, centroid: object) -> PosePrior | None:
        if base_T_camera.translation[0] > 0:
            raise InvalidInput("The covariance is none.", "")
        return PosePrior(Pose.of(np.eye(3), (2.0, 0.0, 0.0)), np.diag([1e-3] * 6))


@pytest.mark.parametrize("x", [-1.0, 1.0])
def test_a_prediction_that_is_no_prior_is_not_used(x: float) -> None:
    assert predict_prior(Wild(), Pose.of(np.eye(3), (x, 0.0, 0.0)), np.zeros(3)) is None


def test_a_camera_that_moved_is_warned_of_with_what_to_do() -> None:
    assert warn_of_drift("head", CalibrationDrift()) == []
    for state, code in (("moved", "camera-moved"), ("suspected", "camera-suspected")):
        (warning,) = warn_of_drift("head", CalibrationDrift(state, "five"))
        assert warning.code == code
        assert "head" in warning.detail
        assert "five" in warning.detail
        assert warning.remedy
    event = describe_event("head", CameraEntry("six", 1.0, "It failed."), CalibrationDrift("moved", "five"))
    assert event["id"] == "head"
    assert (event["counts"], event["reason"]) == (False, "It failed.")
    assert event["drift"] == {"state": "moved", "since": "five"}
    assert [warning["code"] for warning in event["warnings"]] == ["camera-moved"]


def test_a_camera_of_which_nothing_is_known_claims_nothing() -> None:
    summary = counted("one", 0).summary
    assert summary is not None
    memory = CameraMemory(Pose.of(np.eye(3), (0.1, 0.2, 0.3)), summary, 0, (), ())
    camera = describe_camera("head", memory, Calibration())
    assert camera.base_T_camera_covariance is None
    assert camera.base_T_camera.is_close(memory.base_T_camera)
    assert np.diag(camera.covariance).min() >= 1e-4
    assert camera.residual.translation_std >= 0.01


def test_what_the_estimator_rejects_is_among_those_left_out() -> None:
    summary = counted("one", 0).summary
    assert summary is not None
    entries = tuple(counted(f"s{k}", 0, 10.0 + k).entry for k in range(3))
    memory = CameraMemory(Pose.identity(), summary, 3, entries, (CameraEntry("failed", 11.5, "It failed."),))
    camera = describe_camera("head", memory, Calibration(rejected={"s1": "It disagrees.", "s9": "It is gone."}))
    assert [(each.session, each.reason) for each in camera.left_out] == [
        ("s1", "It disagrees."),
        ("failed", "It failed."),
    ]
    assert [each.session for each in camera.history] == ["s0", "s1", "s2"]


class Sure(Calibration):
    """Knows the correction at an object."""

    def predict(self, base_T_camera: Pose, centroid: object) -> PosePrior | None:
        return PosePrior(ERROR, np.diag([4e-4, 1e-4, 2e-4, 4e-6, 9e-6, 1e-6]))


ERROR = Pose.from_rotation_vector((0.01, 0.0, 0.02), (0.01, 0.0, 0.0))


def test_the_cameras_covariance_is_that_of_the_prediction_at_the_object_seen_from_the_camera() -> None:
    """Against errors of the correction at the object, each applied to the camera."""
    update = counted("one", 0)
    assert update.summary is not None
    found = update.entry.observation
    assert found is not None
    memory = CameraMemory(found.base_T_camera, update.summary, 1, (update.entry,), ())
    described = describe_camera("head", memory, Sure()).base_T_camera_covariance
    assert described is not None
    prior = Sure().predict(found.base_T_camera, found.centroid)
    assert prior is not None
    draws = np.sqrt(6) * np.linalg.cholesky(prior.covariance).T  # as few as have this covariance
    camera, place = ERROR.apply(found.base_T_camera.translation), ERROR.apply(found.centroid)
    errors = np.hstack([draws[:, :3], draws[:, 3:] + np.cross(draws[:, :3], camera - place)])
    np.testing.assert_allclose(errors.T @ errors / 6, described, atol=1e-12)
