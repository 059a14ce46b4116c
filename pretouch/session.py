"""The types of the session contract, which REST and gRPC share: requests, plans, scans and the session itself."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from pretouch.calibrated_camera import check_camera_id
from pretouch.camera import Camera
from pretouch.errors import InvalidInput, TooLarge
from pretouch.estimate import Estimate
from pretouch.geometry import MAX_DISTANCE, Array, Plane, Points3, Pose, frozen_array
from pretouch.prior import AnyPrior
from pretouch.rectangle import RotatedRectangle
from pretouch.session_warning import SessionWarning
from pretouch.tof import MAX_SAMPLES, MAX_TIME, RangeSamples, Sensor
from pretouch.trajectory import Trajectory

MIN_SPEED = 1e-6
"""m/s; a slower scan would not end."""
MAX_TOLERANCE_POINTS = 64
"""Points of `tolerance.at`."""
_MAX_SIDE = 100_000
"""px: longest side of an image that intrinsics are made for."""


class State(StrEnum):
    """Whether a session awaits a scan, or how it ended."""

    AWAITING_SCAN = "awaiting_scan"
    CONVERGED = "converged"
    EXHAUSTED = "exhausted"
    FAILED = "failed"
    CANCELLED = "cancelled"

    @property
    def ended(self) -> bool:
        return self is not State.AWAITING_SCAN


class Proposer(StrEnum):
    """How the detector proposes regions, the best first."""

    DEEP = "deep"
    STABILITY = "stability"
    RANDOM = "random"
    NARF = "narf"


class Planner(StrEnum):
    """How the next region is chosen: by the information in its scan, or by the proposer's confidence."""

    INFORMATION = "information"
    CONFIDENCE = "confidence"


def _positive(owner: Any, member: str, limits: dict[str, float]) -> None:
    for name, limit in limits.items():
        label = f"{member}.{name}"
        value = float(frozen_array(getattr(owner, name), (), label))
        if not 0 < value <= limit:
            raise InvalidInput(f"{label} is {value:g}.", f"Need a value above 0, at most {limit:g}.")
        object.__setattr__(owner, name, value)


@dataclass(frozen=True, eq=False)
class Tolerance:
    """When a session has converged: the mean point error is within `error` with `confidence`, and the estimate explains
    the samples.

    Attributes:
        error: largest mean point error that is good enough, in metres.
        confidence: probability with which the mean point error must be within `error`, in (0, 1).
        at: 1 to 64 points (x, y, z) in base, as the camera puts them, in metres, where the error counts, such as a
            grasp's contacts or a cup's axis; left out: the object's visible points.

    Raises:
        Malformed: a value is not finite.
        InvalidInput: a value out of its limits.
    """

    error: float = 0.003
    confidence: float = 0.95
    at: Points3 | None = None

    def __post_init__(self) -> None:
        _positive(self, "tolerance", {"error": 1.0, "confidence": 0.9999})
        if self.at is None:
            return
        at = frozen_array(self.at, (None, 3), "tolerance.at", MAX_DISTANCE)
        if not 1 <= len(at) <= MAX_TOLERANCE_POINTS:
            raise InvalidInput(
                f"tolerance.at has {len(at)} points.",
                f"Need 1 to {MAX_TOLERANCE_POINTS} points; leave it out for the object's visible points.",
            )
        object.__setattr__(self, "at", at)


@dataclass(frozen=True)
class Budget:
    """What a session may spend; a scan that would exceed it is not planned.

    Attributes:
        scans: number of scans.
        seconds: robot seconds: the sum of the scans' durations.
        fraction: share of the object's visible cloud within 5 mm of a returned sample's point, in (0, 1].
    """

    scans: int = 10
    seconds: float = 120.0
    fraction: float = 0.3

    def __post_init__(self) -> None:
        if isinstance(self.scans, bool) or int(self.scans) != self.scans or not 1 <= self.scans <= 1000:
            raise InvalidInput(f"budget.scans is {self.scans!r}.", "Need a whole number from 1 to 1000.")
        _positive(self, "budget", {"seconds": 1e6, "fraction": 1.0})


@dataclass(frozen=True)
class ScanSettings:
    """How the finger moves.

    Attributes:
        standoff: height of the tip above the surface, in metres.
        speed: largest speed of the tip, in metres per second.
        guarded: whether the robot itself lifts the tip while a range is below 10 mm; paths are then planned from what
            is expected instead of the worst case.
    """

    standoff: float = 0.03
    speed: float = 0.05
    guarded: bool = False

    def __post_init__(self) -> None:
        _positive(self, "scan", {"standoff": 1.0, "speed": 10.0})
        if not isinstance(self.guarded, bool):
            raise InvalidInput(f"scan.guarded is {self.guarded!r:.40}.", "Need true or false.")
        if self.speed < MIN_SPEED:
            raise InvalidInput(f"scan.speed is {self.speed:g} m/s.", f"Need at least {MIN_SPEED:g} m/s.")


@dataclass(frozen=True, eq=False)
class SessionRequest:
    """What a client asks for, without the images.

    Attributes:
        camera: intrinsics of the depth image.
        base_T_camera: extrinsics as the client believes them: the camera in base; the camera frame has x right, y down,
            z forward.
        depth_scale: metres that one stored unit of the depth image stands for; left out: 0.001 for integers, 1 for
            floats.
        width: number of columns of the image that the intrinsics were made for, in pixels; left out: not checked.
        height: number of rows of the image that the intrinsics were made for, in pixels; left out: not checked.
        roi: [u0, v0, u1, v1] in pixels, half-open: the part of the image to look in; with a mask, their intersection.
        table: the table in base, as the camera puts it, offset in metres; left out: estimated from the depth image.
        base_T_object: pose of the object in base, as the camera puts it, which the estimate then holds corrected.
        prior: what is believed of the camera's calibration error beforehand; left out: the defaults of Prior.
        tolerance: when the session has converged; left out: the defaults.
        budget: what the session may spend; left out: the defaults.
        sensor: the range sensor in the robot's fingertip; left out: the defaults.
        scan: how the finger moves; left out: the defaults.
        proposer: how regions are proposed; left out: the best proposer that is ready.
        planner: how the next region is chosen: by what its scan would tell, or by the proposer's confidence.
        camera_id: name of the camera, of letters, digits, ".", "_" and "-": sessions that give the same name learn its
            calibration error from each other; left out: nothing is learned.

    Raises:
        Malformed: a value is not finite.
        InvalidInput: a value out of its limits, or members that do not fit each other.
    """

    camera: Camera
    base_T_camera: Pose
    depth_scale: float | None = None
    width: int | None = None
    height: int | None = None
    roi: tuple[int, int, int, int] | None = None
    table: Plane | None = None
    base_T_object: Pose | None = None
    prior: AnyPrior | None = None
    tolerance: Tolerance = field(default_factory=Tolerance)
    budget: Budget = field(default_factory=Budget)
    sensor: Sensor = field(default_factory=Sensor)
    scan: ScanSettings = field(default_factory=ScanSettings)
    proposer: Proposer | None = None
    planner: Planner = Planner.INFORMATION
    camera_id: str | None = None

    def __post_init__(self) -> None:
        if self.camera_id is not None:
            check_camera_id(self.camera_id)
        if self.depth_scale is not None:
            _positive(self, "camera", {"depth_scale": 1000.0})
        for name in ("width", "height"):
            if (size := getattr(self, name)) is not None and not 1 <= size <= _MAX_SIDE:
                raise InvalidInput(f"camera.{name} is {size}.", f"Need a whole number from 1 to {_MAX_SIDE}.")
        if self.roi is not None:
            u0, v0, u1, v1 = self.roi
            if not (0 <= u0 < u1 and 0 <= v0 < v1):
                raise InvalidInput(
                    f"roi is {list(self.roi)}.", "Need [u0, v0, u1, v1] with 0 <= u0 < u1 and 0 <= v0 < v1."
                )
        poses = {"base_T_camera": self.base_T_camera, "base_T_object": self.base_T_object}
        poses |= {f"sensor.tip_T_module[{k}]": pose for k, pose in enumerate(self.sensor.tip_T_module)}
        for name, pose in poses.items():
            if pose is not None:
                frozen_array(pose.translation, (3,), name, MAX_DISTANCE)
        if self.table is not None:
            frozen_array(self.table.offset, (), "table.offset", MAX_DISTANCE)
        if not self.sensor.range_min < self.scan.standoff < self.sensor.range_max:
            raise InvalidInput(
                f"scan.standoff is {self.scan.standoff:g} m, outside the sensor's range of "
                f"{self.sensor.range_min:g} to {self.sensor.range_max:g} m.",
                "Choose a standoff at which the sensor can see the surface.",
            )


@dataclass(frozen=True)
class Region:
    """A region that is worth scanning.

    Attributes:
        id: name of the region within the session.
        rectangle: [x, y, w, h, theta] in the client's depth image: centre and sides in pixels, theta in radians from +u
            towards +v.
        confidence: the proposer's score in [0, 1]; higher is better.
        expected_error: what the estimate's expected error would become if this region were scanned next, in metres.
    """

    id: str
    rectangle: RotatedRectangle
    confidence: float
    expected_error: float


@dataclass(frozen=True, eq=False)
class ScanPlan:
    """A path for the fingertip: straight lines and slerp between waypoints.

    Attributes:
        scan_id: name of the scan, with which its samples are submitted.
        path_id: name of what the path follows: a region's id for its perimeter or a part of it, line-1, .. straight
            across the object, nearby-1, .. over the table or things beside the object.
        region_id: name of the region that the path follows; null if it follows none.
        path: times in seconds from 0, and poses `base_T_tip` of the tip in base, z along the beam. The first and the
            last pose are reached along the beam, from above.
        expected_returns: share of the samples that are expected to return a range, in [0, 1].
    """

    scan_id: str
    path_id: str
    region_id: str | None
    path: Trajectory
    expected_returns: float


@dataclass(frozen=True, eq=False)
class Points:
    """A scan as points, from a robot that computes them itself.

    Attributes:
        points: (n, 3) points in base, in metres.

    Raises:
        Malformed: a number is not finite.
        InvalidInput: not points of three numbers each, or one too far away.
        TooLarge: more than MAX_SAMPLES points.
    """

    points: Array

    def __post_init__(self) -> None:
        points = frozen_array(self.points, (None, 3), "points", MAX_DISTANCE)
        if len(points) > MAX_SAMPLES:
            raise TooLarge(f"The scan has {len(points)} points; the limit is {MAX_SAMPLES}.", "Thin out the scan.")
        object.__setattr__(self, "points", points)


@dataclass(frozen=True)
class GatewaySpan:
    """A scan as a span of samples that the sensor gateway holds.

    Attributes:
        device: name of the gateway's device; empty: its only one.
        start: start of the span, in seconds since the Unix epoch on the clock of the gateway's host.
        end: end of the span, in seconds since the Unix epoch on the clock of the gateway's host.

    Raises:
        Malformed: a time is not finite.
        InvalidInput: the end is not after the start.
    """

    device: str
    start: float
    end: float

    def __post_init__(self) -> None:
        for name, label in {"start": "from", "end": "to"}.items():
            object.__setattr__(self, name, float(frozen_array(getattr(self, name), (), f"gateway.{label}", MAX_TIME)))
        if self.end <= self.start:
            raise InvalidInput(
                f"gateway.to is {self.end:f}, not after gateway.from, {self.start:f}.",
                "Send the times of the scan's start and end.",
            )


@dataclass(frozen=True, eq=False)
class Skipped:
    """A scan that could not be made.

    Attributes:
        samples: the samples taken so far, if any.
        reason: "unreachable".

    Raises:
        InvalidInput: another reason.
    """

    samples: RangeSamples | None = None
    reason: str = "unreachable"

    def __post_init__(self) -> None:
        if self.reason != "unreachable":
            raise InvalidInput(f"skipped is {self.reason!r:.80}.", 'The only reason known is "unreachable".')


Submission = RangeSamples | Points | GatewaySpan | Skipped
"""The result of a planned scan."""


@dataclass(frozen=True, eq=False)
class SampleChunk:
    """Samples of a scan that is under way.

    Attributes:
        start: number of the scan's samples before these: how many were told so far.
        samples: the samples, with tip poses in base; none to ask for the progress only.

    Raises:
        InvalidInput: a negative start.
    """

    start: int
    samples: RangeSamples

    def __post_init__(self) -> None:
        if self.start < 0:
            raise InvalidInput(f"from is {self.start}.", "Send the number of samples told so far, 0 or more.")


Telling = SampleChunk | GatewaySpan
"""Samples of a planned scan, told while the robot moves."""


@dataclass(frozen=True)
class ScanProgress:
    """What the samples of a scan under way have told so far.

    Attributes:
        told: number of the scan's samples that were told.
        enough: whether the session would have converged with them: the robot may leave the path, and close the scan.
        expected_error: expected error with the samples that were assessed last, in metres; before that, the session's.
        error_quantile: 95 % quantile of the error with the samples that were assessed last, in metres; before that, the
            session's.
    """

    told: int
    enough: bool
    expected_error: float
    error_quantile: float


@dataclass(frozen=True)
class ScanSummary:
    """A scan that was used.

    Attributes:
        scan_id: name of the scan.
        path_id: name of what the path followed, from its plan.
        region_id: name of the region that was scanned; null if the path followed none.
        samples: number of samples.
        returns: number of samples with a range.
        length: length of the tip's path, in metres: of the plan, or of the samples where they were told as it moved.
        duration: duration of the tip's path, in seconds: of the samples, and at least of the plan unless they were told
            as it moved.
        expected_error: the estimate's expected error after the scan, in metres.
    """

    scan_id: str
    path_id: str
    region_id: str | None
    samples: int
    returns: int
    length: float
    duration: float
    expected_error: float


@dataclass(frozen=True)
class BudgetUsed:
    """What a session has spent.

    Attributes:
        scans: number of scans made.
        seconds: robot seconds: the sum of the scans' durations.
        fraction: share of the object's visible cloud within 5 mm of a returned sample's point, in [0, 1].
    """

    scans: int = 0
    seconds: float = 0.0
    fraction: float = 0.0


@dataclass(frozen=True)
class Forecast:
    """What the rest of a session is expected to take, before its next scan is made.

    Attributes:
        scans: expected number of further scans until the session ends.
        seconds: expected robot seconds of these scans.
        chance: probability that the session converges within its budget, in [0, 1].
    """

    scans: float
    seconds: float
    chance: float


@dataclass(frozen=True, eq=False)
class Session:
    """The present state of a session.

    Attributes:
        id: name of the session.
        state: whether the session awaits a scan, or how it ended.
        proposer: the proposer that is used.
        planner: the planner that is used.
        regions: the regions of the object that are worth scanning, the proposer's best first.
        estimate: the correction and its uncertainty; before the first scan, the prior's.
        next_scan: the path of the next scan, if there is one.
        scans: the scans so far, the oldest first.
        budget_used: what was spent of the budget.
        base_T_object: the corrected pose of the object in base, if the client gave one to correct.
        reason: why the session is exhausted or failed: a problem document (RFC 9457). The type of an exhausted one ends
            in scans, seconds, fraction, nothing-to-gain, out-of-range, misfit or sensor.
        warnings: what is legal but odd about the input, at most one of each kind.
        table: the table in base that was given or found, as the camera puts it, offset in metres.
        created: when it was created, in seconds since the Unix epoch; left out: by a pretouch that did not note it.
        forecast: what the rest of the session is expected to take; null unless it awaits a scan.
    """

    id: str
    state: State
    proposer: Proposer
    planner: Planner
    regions: tuple[Region, ...]
    estimate: Estimate
    next_scan: ScanPlan | None = None
    scans: tuple[ScanSummary, ...] = ()
    budget_used: BudgetUsed = field(default_factory=BudgetUsed)
    base_T_object: Pose | None = None
    reason: dict[str, Any] | None = None
    warnings: tuple[SessionWarning, ...] = ()
    table: Plane | None = None
    created: float | None = None
    forecast: Forecast | None = None
