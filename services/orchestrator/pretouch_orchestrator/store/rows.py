"""Converts records to the columns of the store's tables and back."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pretouch.geometry import Pose
from pretouch.session import Session
from pretouch.tof import RangeSamples, Scan
from pretouch.v1 import common_pb2, orchestrator_pb2
from pretouch.wire import common, session
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.store.protocol import NewEvent

_NO_DEPTH = np.zeros((0, 0), np.float32)


def request_column(record: Record) -> bytes:
    return session.request_to_proto(record.request, _NO_DEPTH).SerializeToString()


def scene_column(record: Record) -> bytes:
    return common.scene_to_proto(record.scene).SerializeToString()


def pose_column(pose: Pose) -> bytes:
    return common.pose_to_proto(pose).SerializeToString()


def view_column(view: Session) -> bytes:
    return session.session_to_proto(view).SerializeToString()


def session_from_view(view: bytes) -> Session:
    return session.session_from_proto(orchestrator_pb2.Session.FromString(view))


def scene_digest(message: bytes) -> bytes:
    """The digest of the scene in a column; see `pretouch.scene.Scene.digest`."""
    return common.scene_from_proto(common_pb2.Scene.FromString(message)).digest


def view_ended(view: bytes) -> int:
    return int(session_from_view(view).state.ended)


@dataclass(frozen=True)
class StepColumns:
    """What one step writes.

    Attributes:
        view: None where the client's view stays as it was.
        beams: of the new scans, the first at `first_beams`.
        samples: newly told ones, the first at `first_samples`; if that is 0 they replace those told before.
        events: type and data of each.
    """

    view: bytes | None
    skipped: str
    answered: str
    ended: int
    beams: list[bytes]
    first_beams: int
    samples: list[bytes]
    first_samples: int
    events: list[tuple[str, str]]

    @staticmethod
    def between(before: Record | None, after: Record, events: Sequence[NewEvent]) -> StepColumns:
        """The columns of the step from `before` to `after`; `before` is None at the creation."""
        seen = len(before.measured) if before else 0
        told = len(before.told) if before and _continues(before, after) else 0
        only_told = before is not None and not events
        return StepColumns(
            None if only_told else view_column(after.to_session()),
            json.dumps(after.skipped),
            json.dumps(after.answered),
            int(after.state.ended),
            [common.scan_to_proto(scan).SerializeToString() for scan in after.measured[seen:]],
            seen,
            [common.samples_to_proto(samples).SerializeToString() for samples in after.told[told:]],
            told,
            event_columns(events),
        )

    @property
    def size(self) -> int:
        """Bytes."""
        texts = sum(len(kind) + len(data) for kind, data in self.events)
        return len(self.view or b"") + sum(map(len, self.beams)) + sum(map(len, self.samples)) + texts


def event_columns(events: Sequence[NewEvent]) -> list[tuple[str, str]]:
    return [(event.type, json.dumps(event.data)) for event in events]


def _continues(before: Record, after: Record) -> bool:
    """Whether the same scan is pending in both, so that what was told of it can only have grown."""
    plans = before.next_scan, after.next_scan
    return plans[0] is not None and plans[1] is not None and plans[0].scan_id == plans[1].scan_id


@dataclass(frozen=True)
class RecordColumns:
    """What is read of a session.

    Attributes:
        row: of the table `session`.
        scene: None where it is that of the record `known`.
        beams: those of the scans that `known` lacks.
        told: samples told of the next scan, after the first `told_before` chunks, which are those of `known`.
    """

    row: Any
    view: bytes
    scene: bytes | None
    beams: list[bytes]
    told: list[bytes]
    told_before: int


def record_from_columns(columns: RecordColumns, known: Record | None) -> Record:
    """The record with these columns; `known`: an earlier state of the same session, if there is one."""
    row, view = columns.row, session_from_view(columns.view)
    if known is None:
        message = orchestrator_pb2.CreateSessionRequest.FromString(row["request"])
        request, _, _ = session.request_from_proto(message)
        scene = common.scene_from_proto(common_pb2.Scene.FromString(columns.scene or b""))
        measured: tuple[Scan, ...] = ()
        told: tuple[RangeSamples, ...] = ()
    else:
        request, scene, measured = known.request, known.scene, known.measured
        told = known.told[: columns.told_before]
    u0, v0 = json.loads(row["origin"])
    return Record(
        id=view.id,
        created=row["created"],
        request=request,
        scene=scene,
        origin=(u0, v0),
        proposer=view.proposer,
        regions=view.regions,
        estimate=view.estimate,
        state=view.state,
        next_scan=view.next_scan,
        scans=view.scans,
        measured=(*measured, *(common.scan_from_proto(common_pb2.Scan.FromString(blob)) for blob in columns.beams)),
        skipped=tuple(json.loads(row["skipped"])),
        told=(*told, *(common.samples_from_proto(common_pb2.Samples.FromString(blob)) for blob in columns.told)),
        answered=tuple(json.loads(row["answered"])),
        budget_used=view.budget_used,
        reason=view.reason,
        warnings=view.warnings,
        forecast=view.forecast,
        version=row["version"],
    )
