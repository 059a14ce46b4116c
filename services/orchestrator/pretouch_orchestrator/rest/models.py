"""Models of the REST contract's JSON documents, for OpenAPI only: `pretouch.wire.json` parses and writes them.

Those of contract types are derived from their dataclasses, which declare names, defaults and descriptions. Here are the
limits, and the documents whose form is their own.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, Field, create_model

from pretouch import camera, estimate, geometry, prior, session, session_warning, tof
from pretouch.tof import MAX_SAMPLES
from pretouch.wire.contract import contract_fields
from pretouch_orchestrator.rest.derived_model import (
    LeftOut,
    Pose,
    StrictModel,
    derive_model,
    extend_model,
    optional_field,
)

Vector3 = Annotated[list[float], Field(min_length=3, max_length=3)]
_Pixel = Annotated[int, Field(ge=0, lt=2**31)]
_Positive = Annotated[float, Field(gt=0)]
_Share = Annotated[float, Field(gt=0, le=1)]
_Std = Annotated[float, Field(ge=1e-6, le=1)]
_Rows = Annotated[list[Annotated[list[float], Field(min_length=6, max_length=6)]], Field(min_length=6, max_length=6)]
_Side = Annotated[int, Field(ge=1, le=100_000)]
_CameraId = Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]{1,64}$")]
_OF_IMAGE = {
    field.name: field.description[:1].upper() + field.description[1:]
    for field in contract_fields(session.SessionRequest)
    if field.name in ("depth_scale", "width", "height", "camera_id")
}
"""What is said about the fields of a request that JSON has in its camera."""

Camera = extend_model(
    derive_model(camera.Camera, StrictModel, fx=_Positive, fy=_Positive),
    depth_scale=(Annotated[float, Field(gt=0, le=1000)] | LeftOut, optional_field(_OF_IMAGE["depth_scale"])),
    width=(_Side | LeftOut, optional_field(_OF_IMAGE["width"])),
    height=(_Side | LeftOut, optional_field(_OF_IMAGE["height"])),
    id=(_CameraId | LeftOut, optional_field(_OF_IMAGE["camera_id"])),
)
Plane = derive_model(geometry.Plane, StrictModel)
Prior = derive_model(prior.Prior, StrictModel, translation_std=_Std, rotation_std=_Std)
PosePrior = derive_model(
    prior.PosePrior, StrictModel, covariance=_Rows | Annotated[list[float], Field(min_length=36, max_length=36)]
)
Tolerance = derive_model(
    session.Tolerance,
    StrictModel,
    error=_Share,
    confidence=Annotated[float, Field(gt=0, le=0.9999)],
    at=Annotated[list[Vector3], Field(min_length=1, max_length=session.MAX_TOLERANCE_POINTS)] | LeftOut,
)
Budget = derive_model(
    session.Budget,
    StrictModel,
    scans=Annotated[int, Field(ge=1, le=1000)],
    seconds=Annotated[float, Field(gt=0, le=1e6)],
    fraction=_Share,
)
Sensor = derive_model(
    tof.Sensor,
    StrictModel,
    range_min=Annotated[float, Field(ge=0, lt=10)],
    range_max=Annotated[float, Field(gt=0, le=10)],
    range_std=Annotated[float, Field(gt=0, le=0.1)],
    beam_half_angle=Annotated[float, Field(ge=0, lt=0.785)],
    rate=Annotated[float, Field(gt=0, le=10_000)],
    tip_T_module=Annotated[list[Pose], Field(min_length=1, max_length=256)],
    range_bias_std=Annotated[float, Field(ge=0, le=0.1)],
)
ScanSettings = derive_model(
    session.ScanSettings, StrictModel, standoff=_Share, speed=Annotated[float, Field(gt=0, le=10)]
)
SessionRequest = derive_model(
    session.SessionRequest,
    StrictModel,
    without=tuple(_OF_IMAGE),
    camera=Camera,
    prior=Prior | PosePrior | LeftOut,
    roi=Annotated[list[_Pixel], Field(min_length=4, max_length=4)] | LeftOut,
)

WeakDirection = derive_model(estimate.WeakDirection, BaseModel)
Mode = derive_model(estimate.Mode, BaseModel, weight=_Share)
Estimate = extend_model(
    derive_model(
        estimate.Estimate,
        BaseModel,
        modes=Annotated[list[Mode], Field(min_length=1)],  # type: ignore[valid-type]
        fit=Annotated[float, Field(ge=0, le=1)],
    ),
    base_T_object=(
        Pose | LeftOut,
        optional_field("The corrected pose of the object in base, if the client gave one to correct."),
    ),
)
Region = derive_model(session.Region, BaseModel)
ScanSummary = derive_model(session.ScanSummary, BaseModel, region_id=str | None)
BudgetUsed = derive_model(session.BudgetUsed, BaseModel)
Forecast = derive_model(session.Forecast, BaseModel, chance=Annotated[float, Field(ge=0, le=1)])
ScanProgress = derive_model(session.ScanProgress, BaseModel)
SessionWarning = derive_model(session_warning.SessionWarning, BaseModel)


class Waypoint(BaseModel):
    """The pose of the tip at a time."""

    t: float = Field(description="Time in seconds from 0, strictly increasing.")
    base_T_tip: Pose = Field(
        description="Pose of the tip in base, translation in metres; the tip frame has z along the beam."
    )


class ScanPlan(BaseModel):
    """A path for the fingertip: straight lines and slerp between waypoints."""

    scan_id: str = Field(description="Name of the scan, with which its samples are submitted.")
    path_id: str = Field(
        description="Name of what the path follows: a region's id for its perimeter or a part of it, line-1, .. "
        "straight across the object, nearby-1, .. over the table or things beside the object."
    )
    region_id: str | None = Field(description="Name of the region that the path follows; null if it follows none.")
    waypoints: list[Waypoint] = Field(
        description="The path. The first and the last pose are reached along the beam, from above."
    )
    length: float = Field(description="Length of the tip's path, in metres.")
    duration: float = Field(description="Duration of the tip's path, in seconds.")
    expected_returns: float = Field(description="Share of the samples that are expected to return a range, in [0, 1].")


class Problem(BaseModel):
    """An RFC 9457 problem document."""

    type: str = Field(description="URI of the kind of problem.")
    title: str = Field(description="The kind of problem in words.")
    status: int = Field(description="The HTTP status.")
    detail: str = Field(description="What was wrong.")
    remedy: str = Field(description="What to do about it.")


Session = derive_model(
    session.Session,
    BaseModel,
    without=("base_T_object",),
    estimate=Estimate,
    next_scan=ScanPlan | None,
    forecast=Forecast | None,
    reason=Problem | LeftOut,
)
SessionList = create_model(
    "SessionList",
    __doc__="A page of sessions, the newest first.",
    sessions=(list[Session], Field(description="The sessions, the newest first.")),  # type: ignore[valid-type]
    next=(str | None, Field(description="Cursor of the following page; null on the last one.")),
)


class Sample(StrictModel):
    """One range sample."""

    t: float = Field(description="Time in seconds, non-decreasing, on one clock.")
    base_T_tip: Pose = Field(
        description="Pose of the tip in base at that time, translation in metres; the tip frame has z along the beam."
    )
    range: Annotated[float, Field(ge=0)] | None = Field(
        description="Range along the beam, in metres; null: the sensor returned none."
    )
    status: Annotated[int, Field(ge=0, le=255)] = Field(0, description="The sensor's own status code; 0 is good.")
    module: Annotated[int, Field(ge=0, le=255)] = Field(
        0, description="Index of the module in the sensor's `tip_T_module`."
    )


class Samples(StrictModel):
    """A scan as measured."""

    samples: Annotated[list[Sample], Field(max_length=MAX_SAMPLES)] = Field(
        description="The samples of the scan, in the order of time, with tip poses in base; where samples were told "
        "during the scan, those that were not, or none."
    )


class SampleChunk(StrictModel):
    """Samples of a scan that is under way."""

    from_: Annotated[int, Field(ge=0, lt=2**31)] = Field(
        alias="from", description="Number of the scan's samples before these: how many were told so far."
    )
    samples: Annotated[list[Sample], Field(max_length=MAX_SAMPLES)] = Field(
        description="The samples, in the order of time, with tip poses in base; none to ask for the progress only."
    )


class Points(StrictModel):
    """A scan as points, from a robot that computes them itself."""

    points: Annotated[list[Vector3], Field(min_length=1, max_length=MAX_SAMPLES)] = Field(
        description="Points (x, y, z) in base, in metres."
    )


class Span(StrictModel):
    """A span of samples that the sensor gateway holds."""

    device: str = Field(description="Name of the gateway's device; empty: its only one.")
    from_: float = Field(
        alias="from",
        description="Start of the span, in seconds since the Unix epoch on the clock of the gateway's host.",
    )
    to: float = Field(
        description="End of the span, in seconds since the Unix epoch on the clock of the gateway's host."
    )


class GatewaySpan(StrictModel):
    """Samples of a scan that the sensor gateway holds."""

    gateway: Span = Field(description="The span of time in which they were measured.")


class Skipped(StrictModel):
    """A scan that the robot could not make."""

    skipped: Literal["unreachable"] = Field(description="Why not.")
    samples: Annotated[list[Sample], Field(max_length=MAX_SAMPLES)] | LeftOut = optional_field(
        "The samples taken so far, if any, with tip poses in base."
    )


Submission = Samples | Points | GatewaySpan | Skipped
Telling = SampleChunk | GatewaySpan


class Caller(BaseModel):
    """Who calls, by the token that the call carries."""

    owner: str = Field(description="Whose sessions the call sees; empty where there is no token, or a single one.")
    role: Literal["full", "read"] = Field(description="`read`: the call may change nothing.")
    token: bool = Field(description="Whether calls must carry a token.")


class ServiceState(BaseModel):
    """A part that sessions need."""

    name: str = Field(description="`store`, or the name of a service.")
    ready: bool = Field(description="Whether it can be used; of a service with copies, whether one of them can.")
    problem: str | None = Field(description="What is wrong with it, and what to do; null if nothing is.")


class ServiceList(BaseModel):
    """The parts that sessions need."""

    version: str = Field(description="Version of this orchestrator.")
    services: list[ServiceState] = Field(description="The parts, the store first.")


class Health(BaseModel):
    """The service answers."""

    status: Literal["ok", "ready"] = Field(description="`ok`: it answers; `ready`: it can serve sessions.")
