"""Domain types <-> the messages of orchestrator.proto. `x_to_proto` packs, `x_from_proto` unpacks and validates."""

from __future__ import annotations

import json
from enum import StrEnum
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pretouch.camera import Camera
from pretouch.errors import InvalidInput
from pretouch.geometry import Plane
from pretouch.session import (
    Budget,
    BudgetUsed,
    Forecast,
    GatewaySpan,
    Planner,
    Points,
    Proposer,
    Region,
    SampleChunk,
    ScanPlan,
    ScanProgress,
    ScanSettings,
    ScanSummary,
    Session,
    SessionRequest,
    Skipped,
    State,
    Submission,
    Telling,
    Tolerance,
)
from pretouch.session_warning import SessionWarning
from pretouch.tof import RangeSamples
from pretouch.trajectory import Trajectory
from pretouch.v1 import common_pb2, orchestrator_pb2
from pretouch.wire import common
from pretouch.wire.reader import prefix_errors

pb = orchestrator_pb2

_STATES = {
    State.AWAITING_SCAN: pb.SESSION_STATE_AWAITING_SCAN,
    State.CONVERGED: pb.SESSION_STATE_CONVERGED,
    State.EXHAUSTED: pb.SESSION_STATE_EXHAUSTED,
    State.FAILED: pb.SESSION_STATE_FAILED,
    State.CANCELLED: pb.SESSION_STATE_CANCELLED,
}
_NO_SAMPLES = RangeSamples.concatenate([])
_Choice = TypeVar("_Choice", bound=StrEnum)


def request_to_proto(
    request: SessionRequest,
    depth: NDArray[np.generic],
    mask: NDArray[np.generic] | None = None,
    idempotency_key: str = "",
) -> pb.CreateSessionRequest:
    """Packs `request` with stored depth values (h, w), uint16 or float32, and a mask (h, w), non-zero on the object."""
    message = pb.CreateSessionRequest(
        camera=common_pb2.Camera(**common.contract_to_proto(request.camera)),
        depth_scale=request.depth_scale,
        width=request.width,
        height=request.height,
        base_t_camera=common.pose_to_proto(request.base_T_camera),
        depth=common.array_to_proto(depth, "u2" if depth.dtype == np.uint16 else "f4"),
        **common.prior_to_proto(request.prior),
        tolerance=pb.Tolerance(**common.contract_to_proto(request.tolerance)),
        budget=pb.Budget(**common.contract_to_proto(request.budget)),
        sensor=common.sensor_to_proto(request.sensor),
        scan=pb.ScanSettings(**common.contract_to_proto(request.scan)),
        proposer=request.proposer or "",
        planner=request.planner,
        idempotency_key=idempotency_key,
        camera_id=request.camera_id or "",
    )
    if mask is not None:
        message.mask.CopyFrom(common.array_to_proto(np.asarray(mask) != 0, "u1"))
    if request.roi is not None:
        u0, v0, u1, v1 = request.roi
        message.roi.CopyFrom(pb.Roi(u0=u0, v0=v0, u1=u1, v1=v1))
    if request.table is not None:
        message.table.CopyFrom(common_pb2.Plane(**common.contract_to_proto(request.table)))
    if request.base_T_object is not None:
        message.base_t_object.CopyFrom(common.pose_to_proto(request.base_T_object))
    return message


def request_from_proto(
    message: pb.CreateSessionRequest,
) -> tuple[SessionRequest, NDArray[np.generic], NDArray[np.bool_] | None]:
    """The request, stored depth values (h, w) and the mask (h, w), if any; numbers left out take their defaults.

    Raises:
        InvalidInput: a missing member, or a value out of its limits.
        Malformed: a number that is not finite.
    """
    for name in ("camera", "base_t_camera", "depth"):
        if not message.HasField(name):
            raise InvalidInput(f"{name} is missing.", f"Send {name}.")
    given: dict[str, Any] = {}
    if message.HasField("depth_scale"):
        given["depth_scale"] = message.depth_scale
    if message.HasField("width"):
        given["width"] = message.width
    if message.HasField("height"):
        given["height"] = message.height
    if message.HasField("roi"):
        given["roi"] = (message.roi.u0, message.roi.v0, message.roi.u1, message.roi.v1)
    if message.HasField("table"):
        with prefix_errors("table"):
            given["table"] = common.contract_from_proto(message.table, Plane, "table")
    if message.HasField("base_t_object"):
        with prefix_errors("base_t_object"):
            given["base_T_object"] = common.pose_from_proto(message.base_t_object, "base_t_object")
    if message.camera_id:
        given["camera_id"] = message.camera_id
    if message.proposer:
        given["proposer"] = _read_choice(message.proposer, "proposer", Proposer)
    if message.planner:
        given["planner"] = _read_choice(message.planner, "planner", Planner)
    with prefix_errors("base_t_camera"):
        base_T_camera = common.pose_from_proto(message.base_t_camera, "base_t_camera")
    request = SessionRequest(
        camera=common.contract_from_proto(message.camera, Camera, "camera"),
        base_T_camera=base_T_camera,
        prior=common.prior_from_proto(message),
        tolerance=common.contract_from_proto(message.tolerance, Tolerance, "tolerance"),
        budget=common.contract_from_proto(message.budget, Budget, "budget"),
        sensor=common.sensor_from_proto(message.sensor),
        scan=common.contract_from_proto(message.scan, ScanSettings, "scan"),
        **given,
    )
    depth = common.array_from_proto(message.depth, "depth")
    mask = common.array_from_proto(message.mask, "mask") != 0 if message.HasField("mask") else None
    return request, depth, mask


def _read_choice(value: str, name: str, kind: type[_Choice]) -> _Choice:
    if value not in list(kind):
        raise InvalidInput(f"{name} is {value!r:.60}.", f"Choose {', '.join(kind)}.")
    return kind(value)


def scan_plan_to_proto(plan: ScanPlan) -> pb.ScanPlan:
    return pb.ScanPlan(
        scan_id=plan.scan_id,
        path_id=plan.path_id,
        region_id=plan.region_id,
        t=common.array_to_proto(plan.path.t, "f8"),
        base_t_tip=common.array_to_proto(plan.path.base_T_tip, "f8"),
        length=plan.path.length,
        duration=plan.path.duration,
        expected_returns=plan.expected_returns,
    )


def scan_plan_from_proto(message: pb.ScanPlan) -> ScanPlan:
    path = Trajectory(
        common.array_from_proto(message.t, "next_scan.t"),
        common.array_from_proto(message.base_t_tip, "next_scan.base_t_tip"),
    )
    region_id = message.region_id if message.HasField("region_id") else None
    return ScanPlan(message.scan_id, message.path_id, region_id, path, message.expected_returns)


def session_to_proto(session: Session) -> pb.Session:
    """The session as every call answers it."""
    message = pb.Session(
        id=session.id,
        state=_STATES[session.state],
        reason="" if session.reason is None else json.dumps(session.reason),
        proposer=session.proposer,
        planner=session.planner,
        regions=[pb.Region(**common.contract_to_proto(region)) for region in session.regions],
        estimate=common.estimate_to_proto(session.estimate),
        scans=[pb.ScanSummary(**common.contract_to_proto(scan)) for scan in session.scans],
        budget_used=pb.BudgetUsed(**common.contract_to_proto(session.budget_used)),
        warnings=[pb.SessionWarning(**common.contract_to_proto(warning)) for warning in session.warnings],
    )
    if session.table is not None:
        message.table.CopyFrom(common_pb2.Plane(**common.contract_to_proto(session.table)))
    if session.forecast is not None:
        message.forecast.CopyFrom(pb.Forecast(**common.contract_to_proto(session.forecast)))
    if session.next_scan is not None:
        message.next_scan.CopyFrom(scan_plan_to_proto(session.next_scan))
    if session.base_T_object is not None:
        message.base_t_object.CopyFrom(common.pose_to_proto(session.base_T_object))
    if session.created is not None:
        message.created = session.created
    return message


def session_from_proto(message: pb.Session) -> Session:
    """Reads what `session_to_proto` writes.

    Raises:
        InvalidInput: not a session; nothing that a client sent.
    """
    states = {number: state for state, number in _STATES.items()}
    if message.state not in states:
        raise InvalidInput(f"The session's state is {message.state}.", "Use a client as new as the service.")
    return Session(
        id=message.id,
        state=states[message.state],
        proposer=_read_choice(message.proposer, "proposer", Proposer),
        planner=_read_choice(message.planner, "planner", Planner),
        regions=tuple(common.contract_from_proto(region, Region, "region") for region in message.regions),
        estimate=common.estimate_from_proto(message.estimate),
        next_scan=scan_plan_from_proto(message.next_scan) if message.HasField("next_scan") else None,
        scans=tuple(common.contract_from_proto(scan, ScanSummary, "scan") for scan in message.scans),
        budget_used=common.contract_from_proto(message.budget_used, BudgetUsed, "budget_used"),
        base_T_object=common.pose_from_proto(message.base_t_object, "base_t_object")
        if message.HasField("base_t_object")
        else None,
        reason=json.loads(message.reason) if message.reason else None,
        warnings=tuple(common.contract_from_proto(each, SessionWarning, "warning") for each in message.warnings),
        table=common.contract_from_proto(message.table, Plane, "table") if message.HasField("table") else None,
        created=message.created if message.HasField("created") else None,
        forecast=common.contract_from_proto(message.forecast, Forecast, "forecast")
        if message.HasField("forecast")
        else None,
    )


def submission_to_proto(session_id: str, scan_id: str, submission: Submission) -> pb.SubmitScanRequest:
    message = pb.SubmitScanRequest(session_id=session_id, scan_id=scan_id)
    match submission:
        case RangeSamples():
            message.samples.CopyFrom(common.samples_to_proto(submission))
        case Points():
            message.points.points.CopyFrom(common.array_to_proto(submission.points, "f8"))
        case GatewaySpan():
            message.gateway.CopyFrom(_span_to_proto(submission))
        case Skipped():
            taken = None if submission.samples is None else common.samples_to_proto(submission.samples)
            message.skipped.CopyFrom(pb.Skipped(reason=submission.reason, samples=taken))
    return message


def submission_from_proto(message: pb.SubmitScanRequest) -> Submission:
    """Reads what `submission_to_proto` writes.

    Raises:
        InvalidInput: no result, no points, or values that do not fit.
        Malformed: a number that is not finite.
        TooLarge: more than MAX_SAMPLES samples or points.
    """
    match message.WhichOneof("result"):
        case "samples":
            return _read_samples(message.samples)
        case "points":
            points = common.array_from_proto(message.points.points, "points")
            if points.size == 0:
                raise InvalidInput("points is empty.", "Send what the sensor gave, or skip the scan.")
            return Points(points)
        case "gateway":
            return _span_from_proto(message.gateway)
        case "skipped":
            taken = _read_samples(message.skipped.samples) if message.skipped.HasField("samples") else None
            return Skipped(taken, message.skipped.reason)
        case _:
            raise InvalidInput("The scan has no result.", "Send one of samples, points, gateway or skipped.")


def telling_to_proto(session_id: str, scan_id: str, telling: Telling) -> pb.TellSamplesRequest:
    message = pb.TellSamplesRequest(session_id=session_id, scan_id=scan_id)
    match telling:
        case SampleChunk():
            # "from" is a Python keyword, so this message's fields go in by name.
            fields: dict[str, Any] = {"from": telling.start, "samples": common.samples_to_proto(telling.samples)}
            message.chunk.CopyFrom(pb.SampleChunk(**fields))
        case GatewaySpan():
            message.gateway.CopyFrom(_span_to_proto(telling))
    return message


def telling_from_proto(message: pb.TellSamplesRequest) -> Telling:
    """Reads what `telling_to_proto` writes.

    Raises:
        InvalidInput: neither samples nor a span, or values that do not fit.
        Malformed: a number that is not finite.
        TooLarge: more than MAX_SAMPLES samples.
    """
    match message.WhichOneof("telling"):
        case "chunk":
            samples = _read_samples(message.chunk.samples) if message.chunk.HasField("samples") else _NO_SAMPLES
            return SampleChunk(getattr(message.chunk, "from"), samples)
        case "gateway":
            return _span_from_proto(message.gateway)
        case _:
            raise InvalidInput("Neither samples nor a span are told.", "Send one of chunk or gateway.")


def progress_to_proto(progress: ScanProgress) -> pb.ScanProgress:
    return pb.ScanProgress(**common.contract_to_proto(progress))


def progress_from_proto(message: pb.ScanProgress) -> ScanProgress:
    return common.contract_from_proto(message, ScanProgress, "progress")


def _span_to_proto(span: GatewaySpan) -> pb.GatewaySpan:
    # "from" is a Python keyword, so this message's fields go in by name.
    fields: dict[str, Any] = {"device": span.device, "from": span.start, "to": span.end}
    return pb.GatewaySpan(**fields)


def _span_from_proto(message: pb.GatewaySpan) -> GatewaySpan:
    return GatewaySpan(message.device, getattr(message, "from"), message.to)


def _read_samples(message: common_pb2.Samples) -> RangeSamples:
    for name in ("status", "module"):
        if getattr(message, name).type != common_pb2.SCALAR_TYPE_UINT8:
            raise InvalidInput(f"samples.{name} is not packed as UINT8.", f"Send samples.{name} as UINT8.")
    return common.samples_from_proto(message)
