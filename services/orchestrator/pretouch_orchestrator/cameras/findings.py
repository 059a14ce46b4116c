"""What a session's end says about its camera, and what is said about the camera: pure functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from pretouch.calibrated_camera import (
    CalibratedCamera,
    CalibrationDrift,
    CalibrationResidual,
    CameraSession,
    CameraSummary,
    LeftOutSession,
)
from pretouch.errors import TYPE_PREFIX, InvalidInput
from pretouch.estimate import from_prior
from pretouch.exhaustion import Exhaustion
from pretouch.geometry import Array, Pose
from pretouch.prior import AnyPrior
from pretouch.session import State
from pretouch.session_warning import SessionWarning
from pretouch_orchestrator.calibration import Calibration, Observation, assumptions, estimate_calibration
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.store.camera_sql import CANCELLED
from pretouch_orchestrator.store.protocol import MAX_CAMERAS, CameraEntry, CameraMemory

_HONEST = {Exhaustion.SCANS, Exhaustion.SECONDS, Exhaustion.FRACTION, Exhaustion.NOTHING_TO_GAIN}
"""Why a session may end whose estimate is to be believed all the same."""
_DISHONEST = {
    Exhaustion.MISFIT: "Its samples fit no pose.",
    Exhaustion.SENSOR: "Its samples are no measurements.",
    Exhaustion.OUT_OF_RANGE: "The finger met nothing within its range.",
}
_UNKNOWN: Array = np.asarray(np.kron(np.eye(2), assumptions.SIDE.covariance), dtype=np.float64)
"""Covariance of both sides of a camera of which nothing is known."""
_UNKNOWN_RESIDUAL = CalibrationResidual(assumptions.SIDE.translation_std, assumptions.SIDE.rotation_std)
_STEP = 1e-3
"""s from one session's end to the next one's, at least: a clock that was put back does not change their order."""
_KNOCKED = "Check that the camera is fixed to its mount and that base_T_camera is up to date."


def find_reason(record: Record) -> str:
    """Why an ended session does not count, in one sentence; empty if it counts."""
    if record.state is State.CANCELLED:
        return CANCELLED
    if record.state is State.FAILED:
        return "It failed."
    if not record.scans:
        return "It made no scan."
    if record.state is State.EXHAUSTED:
        cause = str((record.reason or {}).get("type", "")).removeprefix(TYPE_PREFIX)
        if cause not in _HONEST:
            return _DISHONEST.get(Exhaustion(cause), "It failed.") if cause in list(Exhaustion) else "It failed."
    return "" if record.estimate.samples else "None of its samples returned a range."


def observe(record: Record, at: float) -> CameraEntry:
    """What an ended session found of its camera, at `at`, s since the Unix epoch.

    Raises:
        InvalidInput: its covariance is none.
    """
    if reason := find_reason(record):
        return CameraEntry(record.id, at, reason)
    estimate, prior, cloud = record.estimate, record.prior, record.scene.cloud
    # Where the samples contradict the prior, the registrar has made the estimate under a wider one about the same mean.
    contradicted = prior.is_contradicted_by(estimate.base_T_correction, estimate.centroid, estimate.covariance)
    moved = np.linalg.norm(estimate.base_T_correction.apply(cloud) - cloud, axis=1)
    return CameraEntry(
        record.id,
        at,
        observation=Observation(
            session_id=record.id,
            at=at,
            base_T_camera=record.request.base_T_camera,
            base_T_correction=estimate.base_T_correction,
            centroid=estimate.centroid,
            covariance=estimate.covariance,
            prior_mean=prior.mean,
            prior_covariance=prior.fallback.covariance if contradicted else prior.covariance,
        ),
        error=float(moved.mean()),
        expected_error=from_prior(prior, cloud).expected_error,
    )


def list_observations(entries: Sequence[CameraEntry]) -> list[Observation]:
    """What the entries observed, in their order: each is of a later time than the one before, whatever clocks said."""
    observations: list[Observation] = []
    for entry in entries:
        if entry.observation is not None:
            earliest = observations[-1].at + _STEP if observations else entry.at
            observations.append(replace(entry.observation, at=max(entry.at, earliest)))
    return observations


def calibrate(entries: Sequence[CameraEntry]) -> Calibration:
    """What the sessions that count say together of their camera."""
    return estimate_calibration(list_observations(entries))


def predict_prior(calibration: Calibration, base_T_camera: Pose, centroid: Array) -> AnyPrior | None:
    """What the camera's earlier sessions say of its error at an object; None where they say nothing that can be used.

    Args:
        base_T_camera: as the client believes it.
        centroid: (3,), m, mean of the object's cloud in base.
    """
    try:
        prior = calibration.predict(base_T_camera, centroid)
        if prior is not None:
            prior.check_mean(centroid)
    except InvalidInput:  # so far away, or so uncertain, that it is no prior
        return None
    return prior


def summarize(camera_id: str, sessions: int, calibration: Calibration) -> CameraSummary:
    """The camera in the list of all, given its calibration and how many sessions counted."""
    residual = CalibrationResidual(calibration.residual_translation_std, calibration.residual_rotation_std)
    return CameraSummary(
        camera_id,
        sessions,
        calibration.camera_T_camera,
        calibration.base_T_base,
        residual if calibration.count else _UNKNOWN_RESIDUAL,
        CalibrationDrift(str(calibration.drift.state), calibration.drift.since),
    )


def warn_of_drift(camera_id: str, drift: CalibrationDrift) -> list[SessionWarning]:
    """That the camera is not where it was; a session that merely disagrees is told by the state, not by a warning."""
    if drift.state == "moved":
        detail = (
            f"From session {drift.since} on the camera {camera_id} is not where the sessions before found it: it was "
            "knocked or mounted anew. What they taught is not used."
        )
        remedy = f"{_KNOCKED} If it was moved on purpose, nothing need be done: the next sessions learn it anew."
        return [SessionWarning("camera-moved", detail, remedy)]
    return []


def warn_of_room() -> SessionWarning:
    """That a camera is not remembered, since there are too many."""
    return SessionWarning(
        "cameras-full",
        f"{MAX_CAMERAS} other cameras are remembered already; nothing is learned of this one.",
        "Give the same camera the same camera.id in every session, and forget cameras that are gone with DELETE "
        "/v1/cameras/{id}.",
    )


def describe_event(camera_id: str, entry: CameraEntry, drift: CalibrationDrift) -> dict[str, Any]:
    """The data of the event `camera`: whether the session counts, if not why, and what is known of the camera now."""
    warnings = [asdict(warning) for warning in warn_of_drift(camera_id, drift)]
    why = {"reason": entry.reason} if entry.reason else {}
    return {"id": camera_id, "counts": not entry.reason, **why, "drift": asdict(drift), "warnings": warnings}


def describe_camera(camera_id: str, memory: CameraMemory, calibration: Calibration) -> CalibratedCamera:
    """What is known of a camera, given the calibration from what is kept of it."""
    summary = summarize(camera_id, memory.summary.sessions, calibration)
    times = {entry.session_id: entry.at for entry in memory.counted}
    rejected = [
        LeftOutSession(session_id, times[session_id], reason)
        for session_id, reason in calibration.rejected.items()
        if session_id in times
    ]
    left_out = [LeftOutSession(entry.session_id, entry.at, entry.reason) for entry in memory.left_out]
    return CalibratedCamera(
        id=camera_id,
        sessions=summary.sessions,
        base_T_camera=calibration.correct(memory.base_T_camera),
        base_T_camera_covariance=_locate(memory, calibration),
        camera_T_camera=calibration.camera_T_camera,
        base_T_base=calibration.base_T_base,
        covariance=calibration.covariance if calibration.count else _UNKNOWN,
        residual=summary.residual,
        drift=summary.drift,
        history=tuple(
            CameraSession(entry.session_id, entry.at, entry.error, entry.expected_error) for entry in memory.counted
        ),
        left_out=tuple(sorted([*left_out, *rejected], key=lambda each: each.at)),
    )


def _locate(memory: CameraMemory, calibration: Calibration) -> Array | None:
    """6x6, of the error of the corrected base_T_camera; None while nothing is known of it.

    It is what is predicted at the object that the last session saw, moved to the camera by the arm a between them: an
    error (w, d) at the object is (w, d + w x a) at the camera.
    """
    observations = list_observations(memory.counted)
    if not observations:
        return None
    last, believed = observations[-1], memory.base_T_camera
    centroid = believed.apply(last.base_T_camera.inverse().apply(last.centroid))
    prior = predict_prior(calibration, believed, centroid)
    if prior is None:
        return None
    x, y, z = prior.mean.apply(believed.translation) - prior.mean.apply(centroid)
    moved = np.eye(6)
    moved[3:, :3] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    return np.asarray(moved @ prior.covariance @ moved.T, dtype=np.float64)
