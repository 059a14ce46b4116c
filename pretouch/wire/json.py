"""Domain types <-> the JSON of the REST contract. `x_to_json` packs, `x_from_json` unpacks and validates.

What a client sends is read strictly: unknown members, wrong types and null where it is not allowed are `InvalidInput`,
numbers that are not finite `Malformed`. What a service answers may have members that this version does not know.
"""

from __future__ import annotations

from dataclasses import asdict
from enum import StrEnum
from typing import Any, TypeVar

import numpy as np

from pretouch.camera import Camera
from pretouch.errors import InvalidInput
from pretouch.estimate import Estimate, Mode, Prior, WeakDirection
from pretouch.geometry import Plane, Pose
from pretouch.rectangle import RotatedRectangle
from pretouch.session import (
    Budget,
    BudgetUsed,
    Planner,
    Proposer,
    Region,
    ScanPlan,
    ScanSettings,
    ScanSummary,
    Session,
    SessionRequest,
    State,
    Tolerance,
)
from pretouch.tof import Sensor
from pretouch.trajectory import Trajectory
from pretouch.wire import reader
from pretouch.wire.json_samples import pose_objects, poses_from_objects, submission_from_json, submission_to_json
from pretouch.wire.reader import Members, at

__all__ = [
    "estimate_from_json",
    "estimate_to_json",
    "pose_from_json",
    "pose_to_json",
    "request_from_json",
    "request_to_json",
    "scan_plan_from_json",
    "scan_plan_to_json",
    "session_from_json",
    "session_page_from_json",
    "session_to_json",
    "submission_from_json",
    "submission_to_json",
]

_REQUEST = (
    *("camera", "base_T_camera", "roi", "table", "base_T_object", "prior", "tolerance", "budget", "sensor", "scan"),
    *("proposer", "planner"),
)
_SENSOR = ("range_min", "range_max", "range_std", "beam_half_angle", "rate")
_Choice = TypeVar("_Choice", bound=StrEnum)


def pose_to_json(pose: Pose) -> dict[str, Any]:
    return {"translation": pose.translation.tolist(), "rotation": pose.quaternion.tolist()}


def pose_from_json(value: object, path: str = "pose") -> Pose:
    return reader.pose(value, path)


def request_to_json(request: SessionRequest) -> dict[str, Any]:
    """The JSON part `request` of `POST /v1/sessions`; every default is spelled out."""
    document: dict[str, Any] = {
        "camera": asdict(request.camera) | {"depth_scale": request.depth_scale},
        "base_T_camera": pose_to_json(request.base_T_camera),
        "prior": asdict(request.prior),
        "tolerance": asdict(request.tolerance),
        "budget": asdict(request.budget),
        "sensor": {name: getattr(request.sensor, name) for name in _SENSOR}
        | {"tip_T_module": [pose_to_json(pose) for pose in request.sensor.tip_T_module]},
        "scan": asdict(request.scan),
        "planner": request.planner.value,
    }
    if request.roi is not None:
        document["roi"] = list(request.roi)
    if request.table is not None:
        document["table"] = {"normal": request.table.normal.tolist(), "offset": request.table.offset}
    if request.base_T_object is not None:
        document["base_T_object"] = pose_to_json(request.base_T_object)
    if request.proposer is not None:
        document["proposer"] = request.proposer.value
    return document


def request_from_json(document: object) -> SessionRequest:
    """Reads what `request_to_json` writes; members left out take their defaults.

    Raises:
        InvalidInput: an unknown member, a wrong type, a value out of its limits.
        Malformed: a number that is not finite.
    """
    members = Members(document, "", _REQUEST)
    camera = members.members("camera", ("fx", "fy", "cx", "cy", "depth_scale"))
    given: dict[str, Any] = camera.given_numbers("depth_scale")
    if "roi" in members:
        path = members.path("roi")
        roi = reader.items(members.get("roi"), path, 4)
        given["roi"] = tuple(reader.integer(value, f"{path}[{k}]") for k, value in enumerate(roi))
    if "table" in members:
        given["table"] = _table(members.members("table", ("normal", "offset")))
    if "base_T_object" in members:
        given["base_T_object"] = members.pose("base_T_object")
    if "prior" in members:
        names = ("translation_std", "rotation_std")
        given["prior"] = Prior(**members.members("prior", names).given_numbers(*names))
    if "tolerance" in members:
        names = ("error", "confidence")
        given["tolerance"] = Tolerance(**members.members("tolerance", names).given_numbers(*names))
    if "budget" in members:
        given["budget"] = _budget(members.members("budget", ("scans", "seconds", "fraction")))
    if "sensor" in members:
        given["sensor"] = _sensor(members.members("sensor", (*_SENSOR, "tip_T_module")))
    if "scan" in members:
        names = ("standoff", "speed")
        given["scan"] = ScanSettings(**members.members("scan", names).given_numbers(*names))
    if "proposer" in members:
        given["proposer"] = _choice(members, "proposer", Proposer)
    if "planner" in members:
        given["planner"] = _choice(members, "planner", Planner)
    return SessionRequest(
        camera=Camera(**{name: camera.number(name) for name in ("fx", "fy", "cx", "cy")}),
        base_T_camera=members.pose("base_T_camera"),
        **given,
    )


def _table(members: Members) -> Plane:
    normal, offset = members.numbers("normal", 3), members.number("offset")
    with at("table"):
        return Plane(np.array(normal), offset)


def _budget(members: Members) -> Budget:
    given: dict[str, Any] = members.given_numbers("seconds", "fraction")
    if "scans" in members:
        given["scans"] = members.integer("scans")
    return Budget(**given)


def _sensor(members: Members) -> Sensor:
    given: dict[str, Any] = members.given_numbers(*_SENSOR)
    if "tip_T_module" in members:
        path = members.path("tip_T_module")
        given["tip_T_module"] = tuple(
            reader.pose(value, f"{path}[{k}]") for k, value in enumerate(members.items("tip_T_module"))
        )
    return Sensor(**given)


def _choice(members: Members, name: str, kind: type[_Choice]) -> _Choice:
    value = members.text(name)
    if value not in list(kind):
        raise InvalidInput(f"{members.path(name)} is {value!r:.60}.", f"Choose {', '.join(kind)}.")
    return kind(value)


def estimate_to_json(estimate: Estimate, base_T_object: Pose | None) -> dict[str, Any]:
    document: dict[str, Any] = {
        "base_T_correction": pose_to_json(estimate.base_T_correction),
        "centroid": estimate.centroid.tolist(),
        "covariance": estimate.covariance.tolist(),
        "expected_error": estimate.expected_error,
        "error_quantile": estimate.error_quantile,
        "unobservable": [
            {"direction": weak.direction.tolist(), "std": weak.std, "text": weak.text} for weak in estimate.unobservable
        ],
        "modes": [
            {"base_T_correction": pose_to_json(mode.base_T_correction), "weight": mode.weight}
            for mode in estimate.modes
        ],
        "fit": estimate.fit,
        "inliers": estimate.inliers,
        "samples": estimate.samples,
        "rmse": estimate.rmse,
    }
    if base_T_object is not None:
        document["base_T_object"] = pose_to_json(base_T_object)
    return document


def estimate_from_json(members: Members) -> Estimate:
    rows = enumerate(reader.items(members.get("covariance"), members.path("covariance"), 6))
    weak = [
        Members(value, f"{members.path('unobservable')}[{k}]", None)
        for k, value in enumerate(members.items("unobservable"))
    ]
    modes = [Members(value, f"{members.path('modes')}[{k}]", None) for k, value in enumerate(members.items("modes"))]
    return Estimate(
        base_T_correction=members.pose("base_T_correction"),
        centroid=np.array(members.numbers("centroid", 3)),
        covariance=np.array([reader.numbers(row, f"{members.path('covariance')}[{k}]", 6) for k, row in rows]),
        expected_error=members.number("expected_error"),
        error_quantile=members.number("error_quantile"),
        unobservable=tuple(
            WeakDirection(np.array(each.numbers("direction", 6)), each.number("std"), each.text("text"))
            for each in weak
        ),
        inliers=members.integer("inliers"),
        samples=members.integer("samples"),
        rmse=members.number("rmse"),
        modes=tuple(Mode(each.pose("base_T_correction"), each.number("weight")) for each in modes),
        fit=members.number("fit"),
    )


def scan_plan_to_json(plan: ScanPlan) -> dict[str, Any]:
    return {
        "scan_id": plan.scan_id,
        "region_id": plan.region_id,
        "waypoints": [
            {"t": t, "base_T_tip": pose}
            for t, pose in zip(plan.path.t.tolist(), pose_objects(plan.path.base_T_tip), strict=True)
        ],
        "length": plan.path.length,
        "duration": plan.path.duration,
    }


def scan_plan_from_json(value: object, path: str = "next_scan") -> ScanPlan:
    members = Members(value, path, None)
    waypoints = [
        Members(each, f"{path}.waypoints[{k}]", ("t", "base_T_tip"))
        for k, each in enumerate(members.items("waypoints"))
    ]
    poses = poses_from_objects([each.get("base_T_tip") for each in waypoints], f"{path}.waypoints[{{}}].base_T_tip")
    times = np.array([each.number("t") for each in waypoints])
    return ScanPlan(members.text("scan_id"), members.text("region_id"), Trajectory(times, poses))


def session_to_json(session: Session) -> dict[str, Any]:
    """The session as every call answers it."""
    document: dict[str, Any] = {
        "id": session.id,
        "state": session.state.value,
        "proposer": session.proposer.value,
        "planner": session.planner.value,
        "regions": [
            {
                "id": region.id,
                "rectangle": region.rectangle.as_list(),
                "confidence": region.confidence,
                "expected_error": region.expected_error,
            }
            for region in session.regions
        ],
        "estimate": estimate_to_json(session.estimate, session.base_T_object),
        "next_scan": None if session.next_scan is None else scan_plan_to_json(session.next_scan),
        "scans": [asdict(scan) for scan in session.scans],
        "budget_used": asdict(session.budget_used),
    }
    if session.reason is not None:
        document["reason"] = session.reason
    return document


def session_from_json(document: object) -> Session:
    """Reads what `session_to_json` writes.

    Raises:
        InvalidInput: not a session; nothing that a client sent.
    """
    members = Members(document, "", None)
    estimate = members.members("estimate", None)
    regions = [Members(value, f"regions[{k}]", None) for k, value in enumerate(members.items("regions"))]
    scans = [Members(value, f"scans[{k}]", None) for k, value in enumerate(members.items("scans"))]
    used = members.members("budget_used", None)
    next_scan = members.get("next_scan")
    return Session(
        id=members.text("id"),
        state=_choice(members, "state", State),
        proposer=_choice(members, "proposer", Proposer),
        planner=_choice(members, "planner", Planner),
        regions=tuple(
            Region(
                each.text("id"),
                RotatedRectangle(*each.numbers("rectangle", 5)),
                each.number("confidence"),
                each.number("expected_error"),
            )
            for each in regions
        ),
        estimate=estimate_from_json(estimate),
        next_scan=None if next_scan is None else scan_plan_from_json(next_scan),
        scans=tuple(
            ScanSummary(
                scan_id=each.text("scan_id"),
                region_id=each.text("region_id"),
                samples=each.integer("samples"),
                returns=each.integer("returns"),
                length=each.number("length"),
                duration=each.number("duration"),
                expected_error=each.number("expected_error"),
            )
            for each in scans
        ),
        budget_used=BudgetUsed(used.integer("scans"), used.number("seconds"), used.number("fraction")),
        base_T_object=estimate.pose("base_T_object") if "base_T_object" in estimate else None,
        reason=members.get("reason", None),
    )


def session_page_from_json(document: object) -> tuple[tuple[Session, ...], str]:
    """The sessions of a page and the cursor of the next one, empty on the last."""
    members = Members(document, "", None)
    cursor = "" if members.get("next") is None else members.text("next")
    return tuple(session_from_json(value) for value in members.items("sessions")), cursor
