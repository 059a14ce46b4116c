"""The examples of the OpenAPI description: one session, from its request to the answer of its first scan."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from pretouch.camera import Camera
from pretouch.errors import (
    Conflict,
    DeadlineExceeded,
    Forbidden,
    InvalidInput,
    Malformed,
    NotFound,
    Overloaded,
    TooLarge,
    Unauthenticated,
    Unavailable,
    UnsupportedMedia,
    problem,
)
from pretouch.estimate import Estimate, WeakDirection, from_prior
from pretouch.geometry import Plane, Pose
from pretouch.prior import PosePrior, Prior
from pretouch.rectangle import RotatedRectangle
from pretouch.session import (
    BudgetUsed,
    Forecast,
    Planner,
    Proposer,
    Region,
    ScanPlan,
    ScanProgress,
    ScanSummary,
    Session,
    SessionRequest,
    State,
    Tolerance,
)
from pretouch.session_warning import SessionWarning
from pretouch.trajectory import Trajectory
from pretouch.wire.json import progress_to_json, request_to_json, scan_plan_to_json, session_to_json
from pretouch.wire.json_objects import object_to_json

_BOX = np.array([(x, y, z) for x in (0.41, 0.49) for y in (-0.03, 0.03) for z in (0.0, 0.05)])
"""Corners of the object, m, in base."""
_OBJECT = Pose.from_quaternion((0.45, 0.0, 0.025), (0.0, 0.0, 0.0, 1.0))
"""`base_T_object`."""
_DOWN = Pose.of(np.diag([1.0, -1.0, -1.0]), (0.41, -0.03, 0.08))
"""`base_T_tip` of the first waypoint: the beam, z of the tip, points down."""

_REQUEST = SessionRequest(
    Camera(525.0, 525.0, 319.5, 239.5),
    Pose.from_quaternion((-0.045, 0.0, 0.515), (0.6533, -0.6533, 0.2706, -0.2706)),
    depth_scale=0.001,
    width=640,
    height=480,
    roi=(200, 120, 440, 360),
    table=Plane(np.array([0.0, 0.0, 1.0]), 0.0),
    base_T_object=_OBJECT,
    prior=Prior(),
    camera_id="head",
    tolerance=Tolerance(at=np.array([[0.45, 0.0, 0.025], [0.45, 0.0, 0.05]])),
)
_PLAN = ScanPlan(
    "scan-1",
    "region-0",
    "region-0",
    Trajectory(np.array([0.0, 1.6]), np.stack([_DOWN.matrix, Pose.of(_DOWN.rotation, (0.49, -0.03, 0.08)).matrix])),
    expected_returns=0.94,
)
_REGION = Region("region-0", RotatedRectangle(319.5, 231.0, 58.0, 40.0, 0.0), 0.84, 0.0042)
_CREATED = Session(
    id="0f3a9c52d1e84b67",
    state=State.AWAITING_SCAN,
    proposer=Proposer.DEEP,
    planner=Planner.INFORMATION,
    regions=(_REGION,),
    estimate=from_prior(Prior(), _BOX),
    next_scan=_PLAN,
    base_T_object=_REQUEST.base_T_object,
    table=_REQUEST.table,
    created=1767225600.0,
    forecast=Forecast(scans=2.3, seconds=11.4, chance=0.86),
)
_CORRECTION = Pose.from_rotation_vector((0.0, 0.0, 0.02), (0.004, -0.011, 0.002))
_CONVERGED = replace(
    _CREATED,
    state=State.CONVERGED,
    next_scan=None,
    forecast=None,
    estimate=Estimate(
        _CORRECTION,
        _BOX.mean(axis=0),
        np.diag([1e-4, 1e-4, 4e-4, 4e-7, 4e-7, 1e-7]),
        expected_error=0.0014,
        error_quantile=0.0026,
        unobservable=(
            WeakDirection(np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), 0.001, "rotation about the table's normal"),
        ),
        fit=0.41,
        inliers=47,
        samples=48,
        rmse=0.0013,
    ),
    scans=(ScanSummary("scan-1", "region-0", "region-0", 48, 46, _PLAN.path.length, _PLAN.path.duration, 0.0014),),
    budget_used=BudgetUsed(1, _PLAN.path.duration, 0.12),
    base_T_object=_CORRECTION @ _OBJECT,
    warnings=(
        SessionWarning(
            "camera-far", "The object is 2.4 m from the camera, in the median.", "Move the camera nearer if you can."
        ),
    ),
)

COMPLETE_REQUEST: dict[str, Any] = request_to_json(_REQUEST)
"""Every member but the proposer, defaults spelled out."""
MINIMAL_REQUEST: dict[str, Any] = {
    "camera": {name: COMPLETE_REQUEST["camera"][name] for name in ("fx", "fy", "cx", "cy")},
    "base_T_camera": COMPLETE_REQUEST["base_T_camera"],
}
"""The members that have no default."""
POSE_PRIOR = object_to_json(
    PosePrior(
        Pose.from_rotation_vector((0.0, 0.0, 0.01), (0.003, -0.008, 0.001)),
        np.diag([1e-4, 1e-4, 4e-4, 9e-6, 9e-6, 4e-6]),
    )
)
"""What a pose estimator states that knows the object to some 3 mm and 1 deg."""
CREATED = session_to_json(_CREATED)
CONVERGED = session_to_json(_CONVERGED)
SCAN_PLAN = scan_plan_to_json(_PLAN)
SUBMISSIONS: dict[str, dict[str, Any]] = {
    "samples": {
        "samples": [
            {
                "t": 12.0,
                "base_T_tip": SCAN_PLAN["waypoints"][0]["base_T_tip"],
                "range": 0.031,
                "status": 0,
                "module": 0,
            },
            {"t": 13.6, "base_T_tip": SCAN_PLAN["waypoints"][1]["base_T_tip"], "range": None, "status": 7, "module": 0},
        ]
    },
    "points": {"points": [[0.41, -0.03, 0.049], [0.45, -0.03, 0.049]]},
    "gateway": {"gateway": {"device": "finger", "from": 1767225600.0, "to": 1767225601.6}},
    "skipped": {"skipped": "unreachable"},
}
PROGRESS = progress_to_json(ScanProgress(48, True, 0.0014, 0.0026))
TELLINGS: dict[str, dict[str, Any]] = {
    "chunk": {"from": 46, **SUBMISSIONS["samples"]},
    "gateway": SUBMISSIONS["gateway"],
}
DEVICE: dict[str, Any] = {
    "name": "finger",
    "port": "/dev/serial/by-id/usb-Pretouch_Finger_0042-if00",
    "state": "streaming",
    "problem": None,
    "measurements": 18420,
    "refused": 0,
    "lost": 2,
}
DEVICE_STATUS: dict[str, Any] = DEVICE | {
    "format": "binary",
    "rate": 30.0,
    "now": 1767225600.0,
    "clock": {"synchronised": True, "std": 0.0003, "latency": 0.0},
    "modules": [{"range": 0.031, "range_status": "good", "status": 0}],
}
TIP_POSE: dict[str, Any] = {"t": 1767225600.0, "base_T_tip": SCAN_PLAN["waypoints"][0]["base_T_tip"]}
SERVICES: list[dict[str, Any]] = [
    {"name": "store", "ready": True, "problem": None},
    {"name": "registrar", "ready": False, "problem": "No registrar can be reached. Start one or wait."},
]
DOCUMENTS: dict[str, list[dict[str, Any]]] = {
    "SessionRequest": [MINIMAL_REQUEST, COMPLETE_REQUEST, MINIMAL_REQUEST | {"prior": POSE_PRIOR}],
    "Session": [CREATED, CONVERGED],
    "SessionList": [{"sessions": [CONVERGED], "next": None}],
    "ScanPlan": [SCAN_PLAN],
    "ScanProgress": [PROGRESS],
    "Submission": list(SUBMISSIONS.values()),
    "Telling": list(TELLINGS.values()),
    "Health": [{"status": "ok"}],
    "Caller": [{"owner": "cell-3", "role": "full", "token": True}],
    "ServiceState": SERVICES,
    "ServiceList": [{"version": "0.1.0", "services": SERVICES}],
    "Device": [DEVICE],
    "DeviceList": [{"devices": [DEVICE]}],
    "DeviceStatus": [DEVICE_STATUS],
    "TipPose": [TIP_POSE],
    "PosesReport": [{"poses": 161, "out_of_order": 0, "samples": 48, "unposed": 1}],
}
"""The examples of each schema."""
EVENT = 'id: 4\nevent: end\ndata: {"state": "converged"}\n\n'
RANGES = (
    'event: ranges\ndata: {"t": [1767225600.0], "time_std": 0.0003, "epoch": 0, "sequence": [18420], '
    '"range": [[0.031]], "range_status": [["good"]], "status": [[0]], "flags": [[0]], "lost": 0, "overrun": 0}\n\n'
)
METRIC = (
    "# TYPE pretouch_orchestrator_sessions_created_total counter\npretouch_orchestrator_sessions_created_total 3.0\n"
)

PROBLEMS: dict[int, dict[str, Any]] = {
    document["status"]: document
    for document in map(
        problem,
        (
            Malformed("camera.fx is not a finite number.", "Send a finite number for camera.fx."),
            Unauthenticated("The request carries no token.", "Send `Authorization: Bearer TOKEN`."),
            Forbidden("This token may only read.", "Use a token whose role is full."),
            NotFound("There is no session '0f3a9c52d1e84b67'.", "Create a session with POST /v1/sessions."),
            Conflict("The session is converged: there is no next scan.", "Read its estimate, or open a new one."),
            TooLarge("The scan has 20001 samples; the limit is 20000.", "Split or thin out the scan."),
            UnsupportedMedia("The body's type is 'text/plain'.", "Send it as `Content-Type: application/json`."),
            InvalidInput("scan.speed is a string, not a number.", "Send scan.speed as a number."),
            Overloaded("The service is busy.", "Try again after the time in `Retry-After`."),
            Unavailable("The registrar cannot be reached.", "Try again in a few seconds."),
            DeadlineExceeded("The registrar did not answer in time.", "Try again."),
        ),
    )
}
"""A problem document for each HTTP status."""
