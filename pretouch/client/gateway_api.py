"""The sensor gateway's API without I/O: requests from a program's own types, and answers as arrays."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pretouch.errors import InvalidInput
from pretouch.geometry import Array, Pose
from pretouch.tof import RangeSamples
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.wire.common import array_from_proto, pose_to_proto, samples_from_proto

GATEWAY_ADDRESS = "127.0.0.1:50053"
TimedPose = tuple[float, Pose | Array]
"""A time, s, and base_T_tip at that time: a `Pose` or a 4x4 matrix."""


@dataclass(frozen=True, eq=False)
class Ranges:
    """f measurements of k modules that arrived together.

    Attributes:
        t: (f,) s, Unix time by the gateway's clock.
        time_std: one standard deviation of these, s; the error is common to all.
        sequence: (f,) the device's own count.
        epoch: how often the board was seen to restart before.
        range: (f, k) m along the beams, calibrated; NaN: none.
        raw: (f, k) m as the device sent them.
        range_status: (f, k) numbers of the enum `RangeStatus`: 1 is good.
        status: (f, k) the sensor's own codes; 0 is good.
        flags: (f, k) sums of the enum `RangeFlag`.
        lost: measurements missing before the last of these, which the gateway did not receive.
        overrun: measurements dropped before these because this program reads slowly.
    """

    t: Array
    time_std: float
    sequence: NDArray[np.uint32]
    epoch: int
    range: Array
    raw: Array
    range_status: NDArray[np.uint8]
    status: NDArray[np.uint8]
    flags: NDArray[np.uint8]
    lost: int
    overrun: int


@dataclass(frozen=True, eq=False)
class Points:
    """n samples with the tip's pose at the time of each, and the points that their beams met.

    Attributes:
        samples: their times are by the gateway's clock.
        points: (n, 3) m in base; NaN: no range.
        origins, directions: (n, 3) m and (n, 3) unit vectors in base: the beams.
        std: (n,) m, one standard deviation of each point; NaN: no point.
        flags: (n,) sums of the enum `RangeFlag`.
        lost, overrun: measurements lost before these: by the gateway, and because this program reads slowly.
        unposed: measurements dropped because no two tip poses close enough in time enclose them.
        out_of_order: tip poses dropped because one of a later time had been sent before.
        clock_offset: the robot's clock minus the gateway's, s, as stated or estimated, and its standard deviation.
        clock_offset_std: one standard deviation of it, s.
    """

    samples: RangeSamples
    points: Array
    origins: Array
    directions: Array
    std: Array
    flags: NDArray[np.uint8]
    lost: int
    overrun: int
    unposed: int
    out_of_order: int
    clock_offset: float
    clock_offset_std: float


class RobotClock:
    """Tells the gateway the robot's clock in each message, if there is one to tell.

    Args:
        now: the robot's clock, s, whatever it counts from; None: nothing is told.
    """

    def __init__(self, now: Callable[[], float] | None) -> None:
        self._now = now
        self._last = (0.0, 0.0)  # assigned at once: another thread may read it

    @property
    def told(self) -> bool:
        return self._now is not None

    def message(self) -> pb.RobotClock | None:
        """What the next message says."""
        if self._now is None:
            return None
        gateway_now, received = self._last
        return pb.RobotClock(now=self._now(), gateway_now=gateway_now, received=received)

    def note(self, response: pb.StreamPointsResponse) -> None:
        """Remembers when the newest response came."""
        if self._now is not None:
            self._last = (response.now, self._now())


def first_request(
    device: str, tip_T_module: Sequence[Pose], clock_offset: float | None, clock: RobotClock
) -> pb.StreamPointsRequest:
    """The first message of a StreamPoints call."""
    modules = [pose_to_proto(pose) for pose in tip_T_module]
    return pb.StreamPointsRequest(
        device=device, tip_t_module=modules, clock_offset=clock_offset, robot_clock=clock.message()
    )


def pose_request(pose: TimedPose, clock: RobotClock) -> pb.StreamPointsRequest:
    """The message of one tip pose.

    Raises:
        InvalidInput: it is no time and pose.
    """
    t, base_T_tip = pose
    if not math.isfinite(t):
        raise InvalidInput(f"A tip pose is of the time {t!r:.40}.", "Give seconds.")
    message = pose_to_proto(base_T_tip if isinstance(base_T_tip, Pose) else Pose(np.asarray(base_T_tip)))
    return pb.StreamPointsRequest(tip_poses=[pb.TipPose(t=t, base_t_tip=message)], robot_clock=clock.message())


def configure_request(
    device: str, tip_T_module: Iterable[Pose], calibration: pb.Calibration | None, recording: bool | None
) -> pb.ConfigureRequest:
    """What of a device's configuration is to change."""
    modules = [pose_to_proto(pose) for pose in tip_T_module]
    return pb.ConfigureRequest(device=device, tip_t_module=modules, calibration=calibration, recording=recording)


def samples_request(device: str, start: float, end: float) -> pb.GetSamplesRequest:
    fields: dict[str, Any] = {"device": device, "from": start, "to": end}  # "from" is a keyword
    return pb.GetSamplesRequest(**fields)


def ranges_of(response: pb.StreamRangesResponse) -> Ranges:
    """A batch of StreamRanges as arrays."""
    batch = response.batch
    return Ranges(
        t=array_from_proto(batch.t, "t"),
        time_std=batch.time_std,
        sequence=array_from_proto(batch.sequence, "sequence"),
        epoch=batch.epoch,
        range=array_from_proto(batch.range, "range"),
        raw=array_from_proto(batch.raw, "raw"),
        range_status=array_from_proto(batch.range_status, "range_status"),
        status=array_from_proto(batch.status, "status"),
        flags=array_from_proto(batch.flags, "flags"),
        lost=batch.lost,
        overrun=response.overrun,
    )


def points_of(response: pb.StreamPointsResponse) -> Points:
    """A batch of StreamPoints as arrays."""
    return Points(
        samples=samples_from_proto(response.samples),
        points=array_from_proto(response.points, "points"),
        origins=array_from_proto(response.origins, "origins"),
        directions=array_from_proto(response.directions, "directions"),
        std=array_from_proto(response.std, "std"),
        flags=array_from_proto(response.flags, "flags"),
        lost=response.lost,
        overrun=response.overrun,
        unposed=response.unposed,
        out_of_order=response.out_of_order,
        clock_offset=response.clock_offset,
        clock_offset_std=response.clock_offset_std,
    )
