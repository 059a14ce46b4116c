"""Sessions that name a camera, and what their ends say of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pretouch_orchestrator.calibration import Observation
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.store.camera_rows import new_summary_column, summary_from_row
from pretouch_orchestrator.store.protocol import CameraEntry, CameraUpdate

from helpers.records import a_record
from pretouch.calibrated_camera import CalibrationDrift
from pretouch.geometry import Pose
from pretouch.session import BudgetUsed, ScanSummary, State
from pretouch.tof import Scan


def camera_record(session_id: str, camera: str = "head", **changes: object) -> Record:
    """A session that awaits a scan."""
    record = a_record(session_id)
    return replace(record, request=replace(record.request, camera_id=camera), answered=(), **changes)  # type: ignore[arg-type]


def converged(record: Record) -> Record:
    """After a scan with which it converges."""
    beams = Scan(np.full((3, 3), 1 / 3), np.tile([0.0, 0.0, -1.0], (3, 1)), np.array([0.03, np.nan, 0.1 / 3]))
    return replace(
        record,
        state=State.CONVERGED,
        next_scan=None,
        estimate=replace(record.estimate, sensor_problem="", samples=3),
        scans=(ScanSummary("s2", "line-3", None, 3, 2, 0.1, 2.0, 0.01),),
        measured=(beams,),
        answered=("s2",),
        budget_used=BudgetUsed(1, 2.0, 0.1),
    )


def an_observation(session_id: str, at: float) -> Observation:
    """With numbers that any rounding would change."""
    return Observation(
        session_id,
        at,
        Pose.from_rotation_vector([0.1, 0.2, 1 / 3], [0.1, 1 / 3, 0.7]),
        Pose.from_rotation_vector([0.01, 0.02, 0.01 / 3], [0.001, 0.01 / 3, 0.007]),
        np.array([0.4, 1 / 3, 0.02]),
        np.diag([1e-4 / 3] * 3 + [1e-6 / 3] * 3),
        Pose.identity(),
        np.diag([2.5e-3] * 3 + [1.3e-4] * 3),
    )


def counted(session_id: str, last: int, at: float = 1.7e9 + 1 / 3, state: str = "steady") -> CameraUpdate:
    """A session that counts, and that was computed from the observations up to `last`."""
    summary = summary_from_row({"id": "head", "summary": new_summary_column("head"), "sessions": 0})
    drift = CalibrationDrift(state, None if state == "steady" else session_id)
    entry = CameraEntry(session_id, at, "", an_observation(session_id, at), 0.01 / 3, 0.02 / 3)
    return CameraUpdate(entry, replace(summary, drift=drift), last)


def left_out(session_id: str, reason: str = "It failed.") -> CameraUpdate:
    return CameraUpdate(CameraEntry(session_id, 1.7e9, reason))
