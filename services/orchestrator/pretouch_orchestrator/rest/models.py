"""Models of the REST contract's JSON documents, for OpenAPI only: `pretouch.wire.json` parses and writes them."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field
from pydantic.json_schema import SkipJsonSchema

from pretouch import session as domain
from pretouch.tof import MAX_SAMPLES

Vector3 = Annotated[list[float], Field(min_length=3, max_length=3)]
Vector6 = Annotated[list[float], Field(min_length=6, max_length=6)]
Pixel = Annotated[int, Field(ge=0, lt=2**31)]
Positive = Annotated[float, Field(gt=0)]
_TOLERANCE, _BUDGET, _SCAN = domain.Tolerance(), domain.Budget(), domain.ScanSettings()


def _optional(description: str) -> Any:
    """A member that may be left out, but must not be null."""
    return Field(None, description=description, json_schema_extra=_without_default)


def _without_default(schema: dict[str, Any]) -> None:
    del schema["default"]


class _Strict(BaseModel):
    """A document sent by clients: other members than these are refused."""

    model_config = ConfigDict(extra="forbid")


class Pose(_Strict):
    """A rigid transform `a_T_b`: maps a point in b to a."""

    translation: Vector3 = Field(description="Metres.", examples=[[0.45, 0.0, 0.3]])
    rotation: Annotated[list[float], Field(min_length=4, max_length=4)] = Field(
        description="Unit quaternion x, y, z, w; its norm within 1e-3 of 1.", examples=[[0.0, 0.0, 0.0, 1.0]]
    )


class Camera(_Strict):
    """Pinhole intrinsics of the depth image; pixel centres at integers, no distortion."""

    fx: Positive = Field(description="Pixels.", examples=[525.0])
    fy: Positive = Field(description="Pixels.", examples=[525.0])
    cx: float = Field(description="Pixels.", examples=[319.5])
    cy: float = Field(description="Pixels.", examples=[239.5])
    depth_scale: Annotated[float, Field(gt=0, le=1000)] = Field(
        domain.SessionRequest.depth_scale, description="Metres that one stored depth unit stands for."
    )


class Table(_Strict):
    """The table in base: all p with normal . p = offset."""

    normal: Vector3 = Field(description="Unit, away from the table.", examples=[[0.0, 0.0, 1.0]])
    offset: float = Field(description="Metres.", examples=[0.0])


class Prior(_Strict):
    """How wrong the camera's calibration may be, about the object's centroid."""

    translation_std: Annotated[float, Field(ge=1e-6, le=1)] = Field(0.0115, description="Metres, per base axis.")
    rotation_std: Annotated[float, Field(ge=1e-6, le=1)] = Field(0.05, description="Radians, per base axis.")


class Tolerance(_Strict):
    """Converged: the `confidence` quantile of the mean point error is at most `error`, and the samples explained."""

    error: Annotated[float, Field(gt=0, le=1)] = Field(_TOLERANCE.error, description="Metres.")
    confidence: Annotated[float, Field(gt=0, le=0.9999)] = Field(_TOLERANCE.confidence)


class Budget(_Strict):
    """What the session may spend; a scan that would exceed it is not planned."""

    scans: Annotated[int, Field(ge=1, le=1000)] = Field(_BUDGET.scans)
    seconds: Annotated[float, Field(gt=0, le=1e6)] = Field(_BUDGET.seconds, description="Robot seconds.")
    fraction: Annotated[float, Field(gt=0, le=1)] = Field(
        _BUDGET.fraction, description="Share of the object's visible cloud within 5 mm of a returned sample's point."
    )


class Sensor(_Strict):
    """The fingertip's range sensor."""

    range_min: Annotated[float, Field(ge=0, lt=10)] = Field(0.01, description="Metres along the beam.")
    range_max: Annotated[float, Field(gt=0, le=10)] = Field(0.10, description="Metres; beyond it there is no return.")
    range_std: Annotated[float, Field(gt=0, le=0.1)] = Field(0.0015, description="Metres.")
    beam_half_angle: Annotated[float, Field(ge=0, lt=0.785)] = Field(0.0, description="Radians; 0 is a thin beam.")
    rate: Annotated[float, Field(gt=0, le=10_000)] = Field(30.0, description="Samples per second of each module.")
    tip_T_module: Annotated[list[Pose], Field(min_length=1, max_length=256)] | SkipJsonSchema[None] = _optional(
        "Pose of each module in the tip frame, z along its beam; left out: one module at the tip."
    )


class ScanSettings(_Strict):
    """How the finger moves."""

    standoff: Annotated[float, Field(gt=0, le=1)] = Field(_SCAN.standoff, description="Metres above the surface.")
    speed: Annotated[float, Field(gt=0, le=10)] = Field(_SCAN.speed, description="Metres per second at most.")


class SessionRequest(_Strict):
    """What a client requests of a session."""

    camera: Camera
    base_T_camera: Pose = Field(description="Extrinsics as believed; camera frame x right, y down, z forward.")
    roi: Annotated[list[Pixel], Field(min_length=4, max_length=4)] | SkipJsonSchema[None] = _optional(
        "[u0, v0, u1, v1], half-open; with a mask, their intersection."
    )
    table: Table | SkipJsonSchema[None] = _optional("Left out: estimated.")
    base_T_object: Pose | SkipJsonSchema[None] = _optional("An object pose to correct along.")
    prior: Prior | SkipJsonSchema[None] = _optional("Left out: its defaults.")
    tolerance: Tolerance | SkipJsonSchema[None] = _optional("Left out: its defaults.")
    budget: Budget | SkipJsonSchema[None] = _optional("Left out: its defaults.")
    sensor: Sensor | SkipJsonSchema[None] = _optional("Left out: its defaults.")
    scan: ScanSettings | SkipJsonSchema[None] = _optional("Left out: its defaults.")
    proposer: domain.Proposer | SkipJsonSchema[None] = _optional("Left out: the best one that is ready.")
    planner: domain.Planner = Field(domain.Planner.INFORMATION)


class Region(BaseModel):
    """A region worth scanning."""

    id: str
    rectangle: Annotated[list[float], Field(min_length=5, max_length=5)] = Field(
        description="[x, y, w, h, theta]: pixels; radians from +u towards +v."
    )
    confidence: float = Field(description="The proposer's score in [0, 1].")
    expected_error: float = Field(description="Metres: the estimate's expected error if this were scanned next.")


class WeakDirection(BaseModel):
    """A direction in which the pose is still weakly constrained."""

    direction: Vector6 = Field(description="Unit: rotation vector scaled by the object's radius, translation.")
    std: float = Field(description="Metres.")
    text: str


class Mode(BaseModel):
    """A pose that explains the samples."""

    base_T_correction: Pose = Field(description="Maps a point from where the camera put it to where this pose has it.")
    weight: float = Field(gt=0, le=1, description="Its probability among the estimate's modes.")


class Estimate(BaseModel):
    """The corrected pose and how sure it is."""

    base_T_correction: Pose = Field(description="Maps a point from where the camera put it to where it truly is.")
    centroid: Vector3 = Field(description="Metres in base: mean of the object's cloud before correction.")
    covariance: Annotated[list[Vector6], Field(min_length=6, max_length=6)] = Field(
        description="Row-major, order (rotation vector, translation), base axes, about the centroid; rad^2, rad m, m^2."
    )
    expected_error: float = Field(description="Metres: expected mean distance of estimated and true object points.")
    error_quantile: float = Field(description="Metres: the 95 % quantile of the same.")
    unobservable: list[WeakDirection]
    modes: list[Mode] = Field(min_length=1, description="The estimate itself first; the weights sum to 1.")
    fit: float = Field(ge=0, le=1, description="p-value of the samples under the estimate; 1 before the first scan.")
    inliers: int
    samples: int
    rmse: float = Field(description="Metres.")
    base_T_object: Pose | SkipJsonSchema[None] = _optional("The corrected object pose, if one was given.")


class Waypoint(BaseModel):
    """The tip's pose at a time."""

    t: float = Field(description="Seconds from 0.")
    base_T_tip: Pose


class ScanPlan(BaseModel):
    """A path for the fingertip: straight lines and slerp between waypoints; approached and left from above."""

    scan_id: str
    region_id: str
    waypoints: list[Waypoint]
    length: float = Field(description="Metres.")
    duration: float = Field(description="Seconds.")


class ScanSummary(BaseModel):
    """A scan that was used."""

    scan_id: str
    region_id: str
    samples: int
    returns: int
    length: float = Field(description="Metres.")
    duration: float = Field(description="Seconds.")
    expected_error: float = Field(description="Metres, after it.")


class BudgetUsed(BaseModel):
    """The part of the budget that is used."""

    scans: int
    seconds: float
    fraction: float


class Problem(BaseModel):
    """An RFC 9457 problem document."""

    type: str
    title: str
    status: int
    detail: str = Field(description="What was wrong.")
    remedy: str = Field(description="What to do about it.")


class Session(BaseModel):
    """The present state of a session."""

    id: str
    state: domain.State
    reason: Problem | SkipJsonSchema[None] = _optional(
        "Why the session is exhausted or failed. If it is exhausted, the type ends in scans, seconds, fraction, "
        "nothing-to-gain, out-of-range, misfit or sensor."
    )
    proposer: domain.Proposer
    planner: domain.Planner
    regions: list[Region]
    estimate: Estimate
    next_scan: ScanPlan | None
    scans: list[ScanSummary]
    budget_used: BudgetUsed


class SessionList(BaseModel):
    """A page of sessions, the newest first."""

    sessions: list[Session]
    next: str | None = Field(description="Cursor of the next page; null on the last one.")


class Sample(_Strict):
    """One range sample."""

    t: float = Field(description="Seconds, non-decreasing.")
    base_T_tip: Pose
    range: Annotated[float, Field(ge=0)] | None = Field(description="Metres along the beam; null: no return.")
    status: Annotated[int, Field(ge=0, le=255)] = Field(0, description="The sensor's own status code; 0 is good.")
    module: Annotated[int, Field(ge=0, le=255)] = Field(0, description="Index in sensor.tip_T_module.")


class Samples(_Strict):
    """A scan as measured."""

    samples: Annotated[list[Sample], Field(min_length=1, max_length=MAX_SAMPLES)]


class Points(_Strict):
    """A scan as points in base, metres, from a robot that computes them itself."""

    points: Annotated[list[Vector3], Field(min_length=1, max_length=MAX_SAMPLES)]


class Span(_Strict):
    """A span of the gateway's samples, seconds since the Unix epoch on its host's clock."""

    device: str = Field(description="Empty: the gateway's only device.")
    from_: float = Field(alias="from")
    to: float


class GatewaySpan(_Strict):
    """A scan whose samples are at the sensor gateway."""

    gateway: Span


class Skipped(_Strict):
    """A scan that the robot could not make; samples taken so far may be included."""

    skipped: Literal["unreachable"]
    samples: Annotated[list[Sample], Field(max_length=MAX_SAMPLES)] | SkipJsonSchema[None] = _optional("May be empty.")


Submission = Samples | Points | GatewaySpan | Skipped


class Health(BaseModel):
    """The service answers."""

    status: Literal["ok", "ready"]
