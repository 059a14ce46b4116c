"""The simulated robot: a plain client of the public API, with a finger in a simulated world.

    robot = DirectRobot(measure)                            # samples at once, in simulated time
    with GatewayRobot(finger, "127.0.0.1:50053") as robot:  # in real time, through the sensor gateway
        for session in drive(client, session, robot.scan):
            ...

Each travels above the object, comes down to a scan along the beam, and lifts after it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any, Protocol, Self

import grpc
import numpy as np
from numpy.typing import NDArray

from pretouch.channel import open_sync_channel
from pretouch.errors import InvalidInput, Unavailable, from_rpc_error
from pretouch.geometry import Array
from pretouch.session import GatewaySpan, ScanPlan
from pretouch.tof import RangeSamples
from pretouch.trajectory import Trajectory
from pretouch.v1 import common_pb2
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.v1.sensor_gateway_pb2_grpc import SensorGatewayServiceStub
from pretouch.wire.common import samples_from_proto
from pretouch_simulation.robot_motion import Motion, motion_around

Measure = Callable[[Array], tuple[Array, NDArray[np.int64]]]
"""Tip poses (n, 4, 4) in base to ranges (n,), m, NaN = none, and status codes (n,)."""

POSE_RATE = 50.0
"""The least rate, per second, at which the robot sends tip poses to the gateway."""
_LEAD = 0.1  # s from announcing a motion to its start
_PATIENCE = 20.0  # s that the gateway may take beyond the motion itself, and to find its device


class DirectRobot:
    """A robot whose finger answers at once: scans cost no real time.

    Args:
        measure: what the one module, at the tip, sees.
        rate: samples per second of simulated time.

    Attributes:
        motions: every motion so far, each from where the one before ended.
    """

    def __init__(self, measure: Measure, rate: float = 30.0) -> None:
        self._measure = measure
        self._rate = rate
        self.motions: list[Motion] = []

    def scan(self, plan: ScanPlan) -> RangeSamples:
        """Makes the planned scan; times count from the plan's start."""
        self.motions.append(_next_motion(self.motions, plan))
        path = plan.path.sampled(self._rate)
        ranges, status = self._measure(path.base_T_tip)
        return RangeSamples(path.t, path.base_T_tip, ranges, status, np.zeros(len(path.t), dtype=np.int64))


class Finger(Protocol):
    """The simulated device at the end of the serial line, which must know its pose: a `FingerProcess`."""

    def play(self, trajectory: Trajectory, start: float | None = None) -> None: ...


class GatewayRobot:
    """A robot in real time: its finger speaks to the sensor gateway, and the robot tells the gateway where its tip is.

    Use it in a `with` block; entering waits until the gateway hears the finger.

    Args:
        finger: is told each motion in advance.
        gateway: `host:port` of the sensor gateway.
        device: the finger's name there; empty: the only one.
        pace: how many times as fast as planned it moves.
        token: the gateway's bearer token, where one is set.

    Attributes:
        motions: every motion so far, as planned, each from where the one before ended.
    """

    def __init__(
        self, finger: Finger, gateway: str, device: str = "", pace: float = 1.0, token: str | None = None
    ) -> None:
        if not pace > 0:
            raise InvalidInput(f"The pace is {pace:g}.", "Give a pace above 0; 1 is as planned.")
        self._finger = finger
        self._device = device
        self._pace = pace
        self._channel = open_sync_channel(gateway, token)
        self._gateway = SensorGatewayServiceStub(self._channel)
        self.motions: list[Motion] = []

    def __enter__(self) -> Self:
        """Waits until the gateway hears the finger.

        Raises:
            Unavailable: it does not within 20 s, or there is no gateway.
        """
        try:
            self._wait_for_finger()
        except BaseException:
            self._channel.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._channel.close()

    def scan(self, plan: ScanPlan) -> RangeSamples:
        """Makes the planned scan and returns the samples that the gateway fused, in s since the Unix epoch."""
        samples, _ = self._play(plan)
        return samples

    def scan_to_gateway(self, plan: ScanPlan) -> GatewaySpan:
        """Makes the planned scan and returns its time span; the gateway keeps the samples."""
        _, span = self._play(plan)
        return span

    def _play(self, plan: ScanPlan) -> tuple[RangeSamples, GatewaySpan]:
        self.motions.append(_next_motion(self.motions, plan))
        motion = self.motions[-1].at_pace(self._pace)
        start = time.time() + _LEAD
        self._finger.play(motion.path, start)
        timeout = motion.path.duration + _LEAD + _PATIENCE
        try:
            answers = self._gateway.StreamPoints(self._tell_poses(motion.path, start), timeout=timeout)
            batches = [samples_from_proto(answer.samples) for answer in answers]
        except grpc.RpcError as error:
            raise from_rpc_error(error) from error
        span = GatewaySpan(self._device, start + motion.start, start + motion.end)
        return _samples_within(batches, span), span

    def _tell_poses(self, path: Trajectory, start: float) -> Iterator[pb.StreamPointsRequest]:
        """Tells the gateway each pose when the tip is there: at POSE_RATE, and at the corners of its path."""
        yield pb.StreamPointsRequest(device=self._device)
        times = np.union1d(np.arange(0.0, path.duration, 1.0 / POSE_RATE), path.t)
        sent = 0
        while sent < len(times):
            time.sleep(max(0.0, start + times[sent] - time.time()))
            due = max(sent + 1, int(np.searchsorted(start + times, time.time(), side="right")))
            now = times[sent:due]
            yield pb.StreamPointsRequest(
                tip_poses=[
                    pb.TipPose(t=start + t, base_t_tip=common_pb2.Pose(matrix=pose.ravel()))
                    for t, pose in zip(now, path.at(now), strict=True)
                ]
            )
            sent = due

    def _wait_for_finger(self) -> None:
        give_up = time.monotonic() + _PATIENCE
        while True:
            try:
                answer = self._gateway.ListDevices(pb.ListDevicesRequest(), timeout=_PATIENCE, wait_for_ready=True)
            except grpc.RpcError as error:
                raise from_rpc_error(error) from error
            devices = [device for device in answer.devices if self._device in ("", device.name)]
            if any(device.state == pb.DEVICE_STATE_STREAMING for device in devices):
                return
            if time.monotonic() > give_up:
                problems = "; ".join(filter(None, (device.problem for device in devices)))
                raise Unavailable(
                    f"The gateway does not hear the finger {self._device!r}. {problems}".strip(),
                    "Start the gateway with the finger's port in PRETOUCH_GATEWAY_DEVICES.",
                )
            time.sleep(0.1)


def _next_motion(motions: list[Motion], plan: ScanPlan) -> Motion:
    return motion_around(plan.path, motions[-1].path.base_T_tip[-1] if motions else None)


def _samples_within(batches: list[RangeSamples], span: GatewaySpan) -> RangeSamples:
    """The samples of all batches that lie in the span, in the order of time.

    Raises:
        Unavailable: there are none.
    """
    columns: dict[str, NDArray[Any]] = {
        name: np.concatenate([getattr(batch, name) for batch in batches]) if batches else np.zeros(0)
        for name in ("t", "base_T_tip", "range", "status", "module")
    }
    order = np.argsort(columns["t"], kind="stable")
    order = order[(columns["t"][order] >= span.start) & (columns["t"][order] <= span.end)]
    if len(order) == 0:
        raise Unavailable("The gateway gave no sample of the scan.", "Look at the gateway's log and its device.")
    return RangeSamples(**{name: column[order] for name, column in columns.items()})
