"""Converts what is kept of cameras to the columns of the store's tables and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from pretouch.calibrated_camera import CalibrationDrift, CalibrationResidual, CameraSummary
from pretouch.geometry import Pose
from pretouch.prior import Prior
from pretouch.v1 import calibrated_camera_pb2 as pb
from pretouch.v1 import common_pb2
from pretouch.wire.calibrated_camera import camera_summary_from_proto, camera_summary_to_proto
from pretouch.wire.common import pose_from_proto, pose_to_proto
from pretouch_orchestrator.calibration import Observation
from pretouch_orchestrator.store.camera_sql import CameraColumns, EntryColumns
from pretouch_orchestrator.store.protocol import CameraEntry, CameraMemory, CameraUpdate


def entry_columns(update: CameraUpdate) -> EntryColumns:
    entry = update.entry
    message = b"" if entry.observation is None else _pack(entry.observation, entry).SerializeToString()
    summary = b"" if update.summary is None else _summary_column(update.summary)
    return EntryColumns(entry.session_id, entry.at, entry.reason, message, summary, update.last)


def memory_from_columns(columns: CameraColumns) -> CameraMemory:
    """The camera as it is kept, its sessions in the order in which they ended."""
    row = columns.row
    observed = [each for each in columns.observations if each["counts"]]
    messages = [pb.CameraObservation.FromString(each["message"]) for each in observed]
    return CameraMemory(
        base_T_camera=pose_from_proto(common_pb2.Pose.FromString(row["believed"]), "camera.believed"),
        last=row["last"],
        summary=summary_from_row(row),
        counted=tuple(
            CameraEntry(
                each["session"],
                each["at"],
                observation=_unpack(message, each["session"], each["at"]),
                error=message.error,
                expected_error=message.expected_error,
            )
            for each, message in zip(observed, messages, strict=True)
        ),
        left_out=tuple(
            CameraEntry(each["session"], each["at"], each["reason"])
            for each in columns.observations
            if not each["counts"]
        ),
    )


def new_summary_column(camera_id: str) -> bytes:
    """The summary of a camera of which nothing is known."""
    unknown = Prior()
    residual = CalibrationResidual(unknown.translation_std, unknown.rotation_std)
    return _summary_column(CameraSummary(camera_id, 0, Pose.identity(), Pose.identity(), residual, CalibrationDrift()))


def summary_from_row(row: Mapping[str, Any]) -> CameraSummary:
    summary = camera_summary_from_proto(pb.CameraSummary.FromString(row["summary"]))
    return replace(summary, id=row["id"], sessions=row["sessions"])


def _summary_column(summary: CameraSummary) -> bytes:
    return camera_summary_to_proto(summary).SerializeToString()


def _pack(observation: Observation, entry: CameraEntry) -> pb.CameraObservation:
    return pb.CameraObservation(
        base_t_camera=pose_to_proto(observation.base_T_camera),
        base_t_correction=pose_to_proto(observation.base_T_correction),
        centroid=observation.centroid,
        covariance=observation.covariance.ravel(),
        prior_mean=pose_to_proto(observation.prior_mean),
        prior_covariance=observation.prior_covariance.ravel(),
        error=entry.error,
        expected_error=entry.expected_error,
    )


def _unpack(message: pb.CameraObservation, session_id: str, at: float) -> Observation:
    return Observation(
        session_id=session_id,
        at=at,
        base_T_camera=pose_from_proto(message.base_t_camera, "observation.base_t_camera"),
        base_T_correction=pose_from_proto(message.base_t_correction, "observation.base_t_correction"),
        centroid=np.array(message.centroid),
        covariance=np.reshape(message.covariance, (6, 6)),
        prior_mean=pose_from_proto(message.prior_mean, "observation.prior_mean"),
        prior_covariance=np.reshape(message.prior_covariance, (6, 6)),
    )
