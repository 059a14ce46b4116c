"""Converts records to the columns of the store's tables and back."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any

import numpy as np

from pretouch.session import Session
from pretouch.tof import RangeSamples, Scan
from pretouch.v1 import common_pb2, orchestrator_pb2
from pretouch.wire import common, session
from pretouch_orchestrator.sessions.record import Record

_NO_DEPTH = np.zeros((0, 0), np.float32)


def fixed_columns(record: Record) -> dict[str, Any]:
    """The columns that never change after the session's creation."""
    return {
        "id": record.id,
        "created": record.created,
        "request": session.request_to_proto(record.request, _NO_DEPTH).SerializeToString(),
        "scene": common.scene_to_proto(record.scene).SerializeToString(),
        "origin": json.dumps(record.origin),
    }


def changing_columns(record: Record) -> dict[str, Any]:
    """The columns that each step may change."""
    return {
        "view": session.session_to_proto(record.to_session()).SerializeToString(),
        "skipped": json.dumps(record.skipped),
        "answered": json.dumps(record.answered),
    }


def samples_column(samples: RangeSamples) -> bytes:
    return common.samples_to_proto(samples).SerializeToString()


def beams_column(scan: Scan) -> bytes:
    return common.scan_to_proto(scan).SerializeToString()


def session_from_view(view: bytes) -> Session:
    return session.session_from_proto(orchestrator_pb2.Session.FromString(view))


def record_from_columns(columns: dict[str, Any], beams: Iterable[bytes], told: Iterable[bytes]) -> Record:
    """The record with these columns; `beams`: those of its scans, and `told`: the samples of the next one, in order."""
    view = session_from_view(columns["view"])
    request, _, _ = session.request_from_proto(orchestrator_pb2.CreateSessionRequest.FromString(columns["request"]))
    u0, v0 = json.loads(columns["origin"])
    return Record(
        id=view.id,
        created=columns["created"],
        request=request,
        scene=common.scene_from_proto(common_pb2.Scene.FromString(columns["scene"])),
        origin=(u0, v0),
        proposer=view.proposer,
        regions=view.regions,
        estimate=view.estimate,
        state=view.state,
        next_scan=view.next_scan,
        scans=view.scans,
        measured=tuple(common.scan_from_proto(common_pb2.Scan.FromString(blob)) for blob in beams),
        skipped=tuple(json.loads(columns["skipped"])),
        told=tuple(common.samples_from_proto(common_pb2.Samples.FromString(blob)) for blob in told),
        answered=tuple(json.loads(columns["answered"])),
        budget_used=view.budget_used,
        reason=view.reason,
        warnings=view.warnings,
    )
