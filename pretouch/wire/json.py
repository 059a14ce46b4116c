"""Domain types <-> the JSON of the REST contract. `x_to_json` packs, `x_from_json` unpacks and validates.

What a client sends is read strictly: unknown members, wrong types and null where it is not allowed are `InvalidInput`,
numbers that are not finite `Malformed`. What a service answers may have members that this version does not know.
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum
from typing import Any, TypeVar

import numpy as np

from pretouch.calibrated_camera import CalibratedCamera, CameraSummary
from pretouch.camera import Camera
from pretouch.errors import InvalidInput
from pretouch.estimate import Estimate
from pretouch.geometry import Plane, Pose
from pretouch.prior import AnyPrior, PosePrior, Prior
from pretouch.session import (
    Budget,
    BudgetUsed,
    Forecast,
    Planner,
    Proposer,
    Region,
    ScanPlan,
    ScanProgress,
    ScanSettings,
    ScanSummary,
    Session,
    SessionRequest,
    State,
    Tolerance,
)
from pretouch.session_warning import SessionWarning
from pretouch.tof import Sensor
from pretouch.trajectory import Trajectory
from pretouch.wire.json_objects import names_in_json, object_from_json, object_to_json, pose_to_json
from pretouch.wire.json_samples import (
    poses_from_json,
    poses_to_json,
    submission_from_json,
    submission_to_json,
    telling_from_json,
    telling_to_json,
)
from pretouch.wire.reader import Members, prefix_errors, read_integer, read_items, read_pose

__all__ = [
    "camera_from_json",
    "camera_list_from_json",
    "camera_list_to_json",
    "camera_to_json",
    "estimate_from_json",
    "estimate_to_json",
    "pose_from_json",
    "pose_to_json",
    "prior_from_json",
    "progress_from_json",
    "progress_to_json",
    "request_from_json",
    "request_to_json",
    "scan_plan_from_json",
    "scan_plan_to_json",
    "session_from_json",
    "session_page_from_json",
    "session_to_json",
    "submission_from_json",
    "submission_to_json",
    "telling_from_json",
    "telling_to_json",
]

_SETTINGS: dict[str, type] = {
    "tolerance": Tolerance,
    "budget": Budget,
    "sensor": Sensor,
    "scan": ScanSettings,
}
"""The members of a request that are contract types of their own."""
_ROWS = 6
"""Rows of a covariance."""
_OF_IMAGE = ("depth_scale", "width", "height")
"""The members of a request that JSON has in its camera."""
_Choice = TypeVar("_Choice", bound=StrEnum)


def pose_from_json(value: object, path: str = "pose") -> Pose:
    return read_pose(value, path)


def request_to_json(request: SessionRequest) -> dict[str, Any]:
    """The JSON part `request` of `POST /v1/sessions`; every default is spelled out."""
    camera = object_to_json(request.camera)
    camera |= {name: value for name in _OF_IMAGE if (value := getattr(request, name)) is not None}
    if request.camera_id is not None:
        camera["id"] = request.camera_id
    document: dict[str, Any] = {
        "camera": camera,
        "base_T_camera": pose_to_json(request.base_T_camera),
        **{name: _settings_to_json(getattr(request, name)) for name in _SETTINGS},
        "planner": request.planner.value,
    }
    if request.prior is not None:
        document["prior"] = object_to_json(request.prior)
    if request.roi is not None:
        document["roi"] = list(request.roi)
    if request.table is not None:
        document["table"] = object_to_json(request.table)
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
    known = ("camera", "base_T_camera", "roi", "table", "base_T_object", "prior", *_SETTINGS, "proposer", "planner")
    members = Members(document, "", known)
    camera = members.members("camera", (*names_in_json(Camera), *_OF_IMAGE, "id"))
    given: dict[str, Any] = {}
    if "depth_scale" in camera:
        given["depth_scale"] = camera.number("depth_scale")
    given |= {name: camera.integer(name) for name in ("width", "height") if name in camera}
    if "id" in camera:
        given["camera_id"] = camera.text("id")
    if "roi" in members:
        path = members.path("roi")
        roi = read_items(members.get("roi"), path, 4)
        given["roi"] = tuple(read_integer(value, f"{path}[{k}]") for k, value in enumerate(roi))
    if "table" in members:
        given["table"] = _read_table(members.members("table", names_in_json(Plane)))
    if "base_T_object" in members:
        given["base_T_object"] = members.pose("base_T_object")
    if "prior" in members:
        given["prior"] = prior_from_json(members.get("prior"))
    for name, kind in _SETTINGS.items():
        if name in members:
            given[name] = _read_settings(members.members(name, names_in_json(kind)), kind)
    if "proposer" in members:
        given["proposer"] = _read_choice(members, "proposer", Proposer)
    if "planner" in members:
        given["planner"] = _read_choice(members, "planner", Planner)
    return SessionRequest(camera=object_from_json(camera, Camera), base_T_camera=members.pose("base_T_camera"), **given)


def prior_from_json(value: object, path: str = "prior") -> AnyPrior:
    """Standard deviations, or a mean and a covariance of 6 rows or of 36 numbers.

    Raises:
        InvalidInput: an unknown member, a wrong type, a value out of its limits.
        Malformed: a number that is not finite.
    """
    of_pose = names_in_json(PosePrior)
    if not (isinstance(value, dict) and any(name in value for name in of_pose)):
        return object_from_json(Members(value, path, names_in_json(Prior)), Prior)
    covariance = value.get("covariance")
    if isinstance(covariance, list) and len(covariance) == _ROWS**2:
        value = value | {"covariance": [covariance[k : k + _ROWS] for k in range(0, _ROWS**2, _ROWS)]}
    return object_from_json(Members(value, path, of_pose), PosePrior)


def _settings_to_json(settings: Any) -> dict[str, Any]:
    """The JSON object without what is left out."""
    return {name: value for name, value in object_to_json(settings).items() if value is not None}


def _read_settings(members: Members, kind: type) -> Any:
    for name in names_in_json(kind):
        if name in members and members.get(name) is None:
            raise InvalidInput(f"{members.path(name)} is null.", f"Leave {members.path(name)} out, or send its value.")
    return object_from_json(members, kind)


def _read_table(members: Members) -> Plane:
    normal, offset = members.numbers("normal", 3), members.number("offset")
    with prefix_errors("table"):
        return Plane(np.array(normal), offset)


def _read_choice(members: Members, name: str, kind: type[_Choice]) -> _Choice:
    value = members.text(name)
    if value not in list(kind):
        raise InvalidInput(f"{members.path(name)} is {value!r:.60}.", f"Choose {', '.join(kind)}.")
    return kind(value)


def estimate_to_json(estimate: Estimate, base_T_object: Pose | None) -> dict[str, Any]:
    """The estimate as REST answers it, with the corrected object pose in base if the client gave one."""
    corrected = {} if base_T_object is None else {"base_T_object": pose_to_json(base_T_object)}
    return object_to_json(estimate) | corrected


def estimate_from_json(members: Members) -> Estimate:
    return object_from_json(members, Estimate)


def estimate_from_document(document: dict[str, Any]) -> Estimate:
    """Reads what `estimate_to_json` writes; the object's pose, which follows from it, is passed over.

    Raises:
        InvalidInput: not an estimate; nothing that a client sent.
    """
    own = {name: value for name, value in document.items() if name != "base_T_object"}
    return estimate_from_json(Members(own, "estimate", None))


def scan_plan_to_json(plan: ScanPlan) -> dict[str, Any]:
    return {
        "scan_id": plan.scan_id,
        "path_id": plan.path_id,
        "region_id": plan.region_id,
        "waypoints": [
            {"t": t, "base_T_tip": pose}
            for t, pose in zip(plan.path.t.tolist(), poses_to_json(plan.path.base_T_tip), strict=True)
        ],
        "length": plan.path.length,
        "duration": plan.path.duration,
        "expected_returns": plan.expected_returns,
    }


def scan_plan_from_json(value: object, path: str = "next_scan") -> ScanPlan:
    members = Members(value, path, None)
    waypoints = [
        Members(each, f"{path}.waypoints[{k}]", ("t", "base_T_tip"))
        for k, each in enumerate(members.items("waypoints"))
    ]
    poses = poses_from_json([each.get("base_T_tip") for each in waypoints], f"{path}.waypoints[{{}}].base_T_tip")
    times = np.array([each.number("t") for each in waypoints])
    return ScanPlan(
        members.text("scan_id"),
        members.text("path_id"),
        None if members.get("region_id") is None else members.text("region_id"),
        Trajectory(times, poses),
        members.number("expected_returns"),
    )


def session_to_json(session: Session) -> dict[str, Any]:
    """The session as every call answers it."""
    document: dict[str, Any] = {
        "id": session.id,
        "state": session.state.value,
        "proposer": session.proposer.value,
        "planner": session.planner.value,
        "regions": [object_to_json(region) for region in session.regions],
        "estimate": estimate_to_json(session.estimate, session.base_T_object),
        "next_scan": None if session.next_scan is None else scan_plan_to_json(session.next_scan),
        "scans": [object_to_json(scan) for scan in session.scans],
        "budget_used": object_to_json(session.budget_used),
        "forecast": None if session.forecast is None else object_to_json(session.forecast),
        "warnings": [object_to_json(warning) for warning in session.warnings],
    }
    if session.table is not None:
        document["table"] = object_to_json(session.table)
    if session.reason is not None:
        document["reason"] = session.reason
    if session.created is not None:
        document["created"] = session.created
    return document


def session_from_json(document: object) -> Session:
    """Reads what `session_to_json` writes.

    Raises:
        InvalidInput: not a session; nothing that a client sent.
    """
    members = Members(document, "", None)
    estimate = members.members("estimate", None)
    next_scan = members.get("next_scan")
    return Session(
        id=members.text("id"),
        state=_read_choice(members, "state", State),
        proposer=_read_choice(members, "proposer", Proposer),
        planner=_read_choice(members, "planner", Planner),
        regions=tuple(object_from_json(each, Region) for each in members.objects("regions")),
        estimate=estimate_from_json(estimate),
        next_scan=None if next_scan is None else scan_plan_from_json(next_scan),
        scans=tuple(object_from_json(each, ScanSummary) for each in members.objects("scans")),
        budget_used=object_from_json(members.members("budget_used", None), BudgetUsed),
        base_T_object=estimate.pose("base_T_object") if "base_T_object" in estimate else None,
        reason=members.get("reason", None),
        warnings=tuple(object_from_json(each, SessionWarning) for each in members.objects("warnings")),
        table=object_from_json(members.members("table", None), Plane) if "table" in members else None,
        created=members.number("created") if "created" in members else None,
        forecast=_read_forecast(members),
    )


def _read_forecast(members: Members) -> Forecast | None:
    if members.get("forecast", None) is None:
        return None
    return object_from_json(members.members("forecast", None), Forecast)


def progress_to_json(progress: ScanProgress) -> dict[str, Any]:
    return object_to_json(progress)


def progress_from_json(document: object) -> ScanProgress:
    """Reads what `progress_to_json` writes; raises `InvalidInput` if it is no progress."""
    return object_from_json(Members(document, "", None), ScanProgress)


def session_page_from_json(document: object) -> tuple[tuple[Session, ...], str]:
    """The sessions of a page and the cursor of the next one, empty on the last."""
    members = Members(document, "", None)
    cursor = "" if members.get("next") is None else members.text("next")
    return tuple(session_from_json(value) for value in members.items("sessions")), cursor


def camera_to_json(camera: CalibratedCamera) -> dict[str, Any]:
    return object_to_json(camera)


def camera_from_json(document: object) -> CalibratedCamera:
    """Reads what `camera_to_json` writes; raises `InvalidInput` if it is no camera."""
    return object_from_json(Members(document, "", None), CalibratedCamera)


def camera_list_to_json(cameras: Iterable[CameraSummary]) -> dict[str, Any]:
    return {"cameras": [object_to_json(camera) for camera in cameras]}


def camera_list_from_json(document: object) -> tuple[CameraSummary, ...]:
    """Reads what `camera_list_to_json` writes; raises `InvalidInput` if it is no list of cameras."""
    return tuple(object_from_json(each, CameraSummary) for each in Members(document, "", None).objects("cameras"))
