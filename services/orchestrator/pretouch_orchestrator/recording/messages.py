"""A session as messages for viewers and for replaying it, from its record and events alone.

The store keeps no times but a session's creation and its scans' durations: a recording's clock shows robot time, in
which the session starts when it was created and each scan follows the one before at once. A scan's beams are spread
evenly over its duration.
"""

from __future__ import annotations

import platform
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf.message import Message
from numpy.typing import NDArray

from pretouch import __version__
from pretouch.estimate import Estimate
from pretouch.geometry import Pose
from pretouch.session import ScanSummary, State
from pretouch.tof import Scan
from pretouch.v1 import session_recording_pb2
from pretouch.wire import common
from pretouch.wire.json import estimate_from_document
from pretouch.wire.registration import settings_to_proto
from pretouch.wire.session import request_to_proto, session_to_proto
from pretouch_orchestrator.recording import drawings, foxglove
from pretouch_orchestrator.sessions.history import list_estimates
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.store.protocol import NewEvent

_MOST_POINTS = 10_000
"""Of a cloud."""
_MOST_CORRECTED = 200_000
"""Points of all corrected clouds together."""
_MOST_PARTS, _PARTS_A_SECOND = 2000, 5.0
"""Parts into which all scans together are cut, so that playing them back shows the finger move."""
_MOST_PLACES = 5000
"""Places of the finger on all scans' paths together."""
_NO_DEPTH = np.zeros((0, 0), np.float32)


@dataclass(frozen=True)
class Entry:
    """A message, the topic that it belongs to, and its time: Unix, ns."""

    topic: str
    time: int
    message: Message


def list_entries(record: Record, events: Iterable[NewEvent]) -> Iterator[Entry]:
    """The messages of a session in whatever state, in the order of their times.

    Args:
        events: those of types `scan` and `estimate`, the oldest first; others are passed over.
    """
    documents = list_estimates(record, events)
    estimates = [estimate_from_document(document) for document in documents]
    time = round(1e9 * max(record.created, 0.0))
    yield Entry("/pretouch/session", time, describe_session(record))
    yield from _show_scene(record, time)
    yield from _show_estimate(record, estimates[0], time)
    scans = zip(record.scans, record.measured, estimates[1:], strict=True)
    for number, (summary, scan, estimate) in enumerate(scans, start=1):
        yield from _show_beams(record, summary, scan, time)
        time += round(1e9 * summary.duration)
        recorded = session_recording_pb2.RecordedScan(
            number=number,
            scan_id=summary.scan_id,
            scan=common.scan_to_proto(scan),
            estimate=common.estimate_to_proto(estimate),
        )
        yield Entry("/pretouch/scans", time, recorded)
        yield from _show_estimate(record, estimate, time)
        text = f"{summary.scan_id} over {summary.path_id}: {summary.returns} of {summary.samples} samples returned"
        yield _log(f"{text}, {1000 * estimate.expected_error:.2f} mm expected", time)
    yield from _show_end(record, time)


def describe_session(record: Record) -> session_recording_pb2.RecordedSession:
    """All that registering the session's scans again needs, the scans left out."""
    u0, v0 = record.origin
    return session_recording_pb2.RecordedSession(
        versions={
            "pretouch": __version__,
            "python": platform.python_version(),
            "numpy": np.__version__,
            "machine": platform.machine(),
        },
        created=record.created,
        request=request_to_proto(record.request, _NO_DEPTH),
        scene=common.scene_to_proto(record.scene),
        u0=u0,
        v0=v0,
        settings=settings_to_proto(
            record.prior, record.request.sensor, record.request.tolerance.at, record.estimate.engine
        ),
        session=session_to_proto(record.to_session()),
    )


def _show_scene(record: Record, time: int) -> Iterator[Entry]:
    scene = record.scene
    yield Entry("/tf", time, foxglove.transforms({"camera": foxglove.pose_message(scene.base_T_camera)}, time))
    yield Entry("/camera/calibration", time, foxglove.calibration(scene, time))
    yield Entry("/camera/depth", time, foxglove.depth_image(scene, time))
    yield Entry("/camera/regions", time, drawings.draw_regions(record, time))
    around = scene.organised[(scene.depth.metres > 0) & ~scene.mask]
    yield Entry("/camera/surroundings", time, foxglove.cloud(_thin(around, _MOST_POINTS), time))
    yield Entry("/object/before", time, foxglove.cloud(_thin(scene.cloud, _MOST_POINTS), time))
    yield Entry("/scene", time, drawings.draw_table(record, time))
    yield _log(f"session {record.id}, {len(record.regions)} regions by {record.proposer.value}", time)


def _show_estimate(record: Record, estimate: Estimate, time: int) -> Iterator[Entry]:
    correction = estimate.base_T_correction
    most = min(_MOST_POINTS, _MOST_CORRECTED // (len(record.scans) + 1))
    after = correction.apply(_thin(record.scene.cloud, most))
    yield Entry("/object/after", time, foxglove.cloud(after, time))
    base_T_object = correction @ (record.request.base_T_object or Pose.of(np.eye(3), estimate.centroid))
    placed = {"corrected_camera": correction @ record.scene.base_T_camera, "object": base_T_object}
    frames = {name: foxglove.pose_message(pose) for name, pose in placed.items()}
    yield Entry("/tf", time, foxglove.transforms(frames, time))
    yield Entry("/object/pose", time, foxglove.odometry(base_T_object, estimate, time))
    yield Entry("/scene", time, drawings.draw_uncertainty(estimate, time))


def _show_beams(record: Record, summary: ScanSummary, scan: Scan, start: int) -> Iterator[Entry]:
    hit, scans = scan.returned, len(record.scans)
    if not len(scan):
        return
    has_beams = bool((scan.ranges[hit] > 0).any()) or not hit.any()
    if has_beams:
        places = _thin(np.arange(len(scan)), max(2, _MOST_PLACES // scans))
        poses = foxglove.beam_poses(scan.origins[places], scan.directions[places])
        yield Entry("/scan/path", start, foxglove.path(poses, start))
    ends = scan.origins + np.where(hit, scan.ranges, record.request.sensor.range_max)[:, None] * scan.directions
    parts = int(np.clip(np.ceil(summary.duration * _PARTS_A_SECOND), 1, max(1, _MOST_PARTS // scans)))
    for part in np.array_split(np.arange(len(scan)), min(parts, len(scan))):
        last = int(part[-1])
        time = start + round(1e9 * summary.duration * (last + 1) / len(scan))
        if has_beams:
            (beam,) = foxglove.beam_poses(scan.origins[[last]], scan.directions[[last]])
            yield Entry("/tf", time, foxglove.transforms({"beam": beam}, time))
        for topic, chosen in (("/scan/hits", part[hit[part]]), ("/scan/misses", part[~hit[part]])):
            if len(chosen):
                yield Entry(topic, time, foxglove.cloud(ends[chosen], time))


def _show_end(record: Record, time: int) -> Iterator[Entry]:
    for warning in record.warnings:
        yield _log(f"{warning.code}: {warning.detail} {warning.remedy}", time, Log.WARNING)
    if record.next_scan is not None:
        tips = [foxglove.pose_message(Pose(matrix)) for matrix in record.next_scan.path.base_T_tip]
        yield Entry("/plan/path", time, foxglove.path(tips, time))
    if record.state.ended:
        reason = record.reason or {}
        text = " ".join([record.state.value, *(str(reason[key]) for key in ("detail", "remedy") if reason.get(key))])
        yield _log(text, time, Log.ERROR if record.state is State.FAILED else Log.INFO)


def _log(text: str, time: int, level: Log.Level.ValueType = Log.INFO) -> Entry:
    return Entry("/events", time, Log(timestamp=foxglove.stamp(time), level=level, message=text, name="pretouch"))


def _thin(values: NDArray[Any], most: int) -> NDArray[Any]:
    """At most `most` of the values, evenly chosen."""
    if len(values) <= most:
        return values
    return np.asarray(values[np.linspace(0, len(values) - 1, most).astype(int)])
