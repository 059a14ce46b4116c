"""A session as its client sees it: the types of the REST and gRPC contracts."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from pretouch.camera import Camera
from pretouch.errors import InvalidInput, TooLarge
from pretouch.estimate import Estimate, Prior
from pretouch.geometry import MAX_DISTANCE, Array, Plane, Pose, frozen_array
from pretouch.rectangle import RotatedRectangle
from pretouch.tof import MAX_SAMPLES, MAX_TIME, RangeSamples, Sensor
from pretouch.trajectory import Trajectory

MIN_SPEED = 1e-6
"""m/s; a slower scan would not end."""


class State(StrEnum):
    """The state of a session; all but `AWAITING_SCAN` are final."""

    AWAITING_SCAN = "awaiting_scan"
    CONVERGED = "converged"
    EXHAUSTED = "exhausted"
    FAILED = "failed"
    CANCELLED = "cancelled"

    @property
    def ended(self) -> bool:
        return self is not State.AWAITING_SCAN


class Proposer(StrEnum):
    """How the detector proposes regions."""

    DEEP = "deep"
    RANDOM = "random"
    NARF = "narf"
    STABILITY = "stability"


class Planner(StrEnum):
    """How the next region is chosen: by the predicted information of its scan, or by the proposer's confidence."""

    INFORMATION = "information"
    CONFIDENCE = "confidence"


def _positive(owner: Any, member: str, limits: dict[str, float]) -> None:
    for name, limit in limits.items():
        label = f"{member}.{name}"
        value = float(frozen_array(getattr(owner, name), (), label))
        if not 0 < value <= limit:
            raise InvalidInput(f"{label} is {value:g}.", f"Need a value above 0, at most {limit:g}.")
        object.__setattr__(owner, name, value)


@dataclass(frozen=True)
class Tolerance:
    """Converged = the `confidence` quantile of the object's mean point error is at most `error`, m, and the
    estimate explains the samples.
    """

    error: float = 0.003
    confidence: float = 0.95

    def __post_init__(self) -> None:
        _positive(self, "tolerance", {"error": 1.0, "confidence": 0.9999})


@dataclass(frozen=True)
class Budget:
    """What a session may spend: scans, robot seconds (the sum of the scans' durations), share of the object scanned."""

    scans: int = 10
    seconds: float = 120.0
    fraction: float = 0.3

    def __post_init__(self) -> None:
        if isinstance(self.scans, bool) or int(self.scans) != self.scans or not 1 <= self.scans <= 1000:
            raise InvalidInput(f"budget.scans is {self.scans!r}.", "Need a whole number from 1 to 1000.")
        _positive(self, "budget", {"seconds": 1e6, "fraction": 1.0})


@dataclass(frozen=True)
class ScanSettings:
    """How the finger moves: `standoff` above the surface, m; never faster than `speed`, m/s."""

    standoff: float = 0.03
    speed: float = 0.05

    def __post_init__(self) -> None:
        _positive(self, "scan", {"standoff": 1.0, "speed": 10.0})
        if self.speed < MIN_SPEED:
            raise InvalidInput(f"scan.speed is {self.speed:g} m/s.", f"Need at least {MIN_SPEED:g} m/s.")


@dataclass(frozen=True, eq=False)
class SessionRequest:
    """What a client asks for, without the images; see the REST contract for each member.

    Raises:
        InvalidInput: members that do not fit each other.
    """

    camera: Camera
    base_T_camera: Pose
    depth_scale: float = 0.001
    roi: tuple[int, int, int, int] | None = None
    table: Plane | None = None
    base_T_object: Pose | None = None
    prior: Prior = field(default_factory=Prior)
    tolerance: Tolerance = field(default_factory=Tolerance)
    budget: Budget = field(default_factory=Budget)
    sensor: Sensor = field(default_factory=Sensor)
    scan: ScanSettings = field(default_factory=ScanSettings)
    proposer: Proposer | None = None
    planner: Planner = Planner.INFORMATION

    def __post_init__(self) -> None:
        _positive(self, "camera", {"depth_scale": 1000.0})
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
    """A rectangle worth scanning.

    Attributes:
        confidence: the proposer's own score in [0, 1].
        expected_error: m, what the estimate's expected error would become if this region were scanned next.
    """

    id: str
    rectangle: RotatedRectangle
    confidence: float
    expected_error: float


@dataclass(frozen=True, eq=False)
class ScanPlan:
    """A path for the fingertip; its time starts at 0, its first and last pose are reached from above."""

    scan_id: str
    region_id: str
    path: Trajectory


@dataclass(frozen=True, eq=False)
class Points:
    """A scan as points (n, 3), m, in base, from a robot that computes them itself.

    Raises:
        Malformed, InvalidInput, TooLarge: see the message.
    """

    points: Array

    def __post_init__(self) -> None:
        points = frozen_array(self.points, (None, 3), "points", MAX_DISTANCE)
        if len(points) > MAX_SAMPLES:
            raise TooLarge(f"The scan has {len(points)} points; the limit is {MAX_SAMPLES}.", "Thin out the scan.")
        object.__setattr__(self, "points", points)


@dataclass(frozen=True)
class GatewaySpan:
    """A scan as a span of samples that the gateway holds; times in s since the Unix epoch on the gateway's clock."""

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
    """A scan that could not be made, with the samples taken so far."""

    samples: RangeSamples | None = None
    reason: str = "unreachable"

    def __post_init__(self) -> None:
        if self.reason != "unreachable":
            raise InvalidInput(f"skipped is {self.reason!r}.", 'The only reason known is "unreachable".')


Submission = RangeSamples | Points | GatewaySpan | Skipped
"""A client's answer to a planned scan."""


@dataclass(frozen=True)
class ScanSummary:
    """A scan that was used: `returns` of `samples` came back; `expected_error`, m, after it."""

    scan_id: str
    region_id: str
    samples: int
    returns: int
    length: float
    duration: float
    expected_error: float


@dataclass(frozen=True)
class BudgetUsed:
    """Spent so far, in the units of `Budget`."""

    scans: int = 0
    seconds: float = 0.0
    fraction: float = 0.0


@dataclass(frozen=True, eq=False)
class Session:
    """The present state of a session.

    Attributes:
        base_T_object: the corrected object pose, if the client gave one to correct.
        next_scan: None when there is none.
        reason: why it is `EXHAUSTED` or `FAILED`, else None: a problem document (RFC 9457) with type, title, status,
            detail and remedy. The type of an exhausted one ends in one of `pretouch.exhaustion.Exhaustion`; one that an
            older pretouch exhausted has none.
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
