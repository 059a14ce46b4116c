"""The simulated robot in real time, through the sensor gateway.

    with GatewayRobot(finger, "127.0.0.1:50053") as robot:
        for session in drive(client, session, robot.stream):
            ...

It travels above the object, comes down to a scan along the beam, and lifts after it, or as soon as it is stopped.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Generator, Iterator
from contextlib import closing
from dataclasses import replace
from typing import Any, Protocol, Self

import grpc
import numpy as np

from pretouch.channel import open_sync_channel
from pretouch.errors import InvalidInput, Unavailable, from_rpc_error
from pretouch.session import GatewaySpan, ScanPlan
from pretouch.tof import RangeSamples
from pretouch.trajectory import Trajectory
from pretouch.v1 import common_pb2
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.v1.sensor_gateway_pb2_grpc import SensorGatewayServiceStub
from pretouch.wire.common import samples_from_proto
from pretouch_simulation.robot_motion import PIECE, Motion, motion_after

POSE_RATE = 50.0
"""The least rate, per second, at which the robot sends tip poses to the gateway."""
_LEAD = 0.1  # s from announcing a motion to its start
_PATIENCE = 20.0  # s that the gateway may take beyond the motion itself, and to find its device


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
        measured: the samples of every scan so far.
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
        self.measured: list[RangeSamples] = []

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
        return RangeSamples.concatenate(list(self.stream(plan)))

    def stream(self, plan: ScanPlan) -> Generator[RangeSamples, None, None]:
        """Makes the planned scan and yields, every PIECE seconds, what the gateway fused; closed, it lifts at once."""
        with closing(self._play(plan)) as played:
            for _, samples in played:
                yield samples

    def stream_spans(self, plan: ScanPlan) -> Generator[GatewaySpan, None, None]:
        """As `stream`, but yields the time spans of the samples, from the scan's start; the gateway keeps these."""
        with closing(self._play(plan)) as played:
            for span, _ in played:
                yield span

    def _play(self, plan: ScanPlan) -> Generator[tuple[GatewaySpan, RangeSamples], None, None]:
        motion = motion_after(self.motions, plan.path)
        paced = motion.at_pace(self._pace)
        start, stop = time.time() + _LEAD, threading.Event()
        span = GatewaySpan(self._device, start + paced.start, start + paced.end)
        self._finger.play(paced.path, start)
        timeout = paced.path.duration + _LEAD + _PATIENCE
        answers = self._gateway.StreamPoints(_tell_poses(self._device, paced.path, start, stop), timeout=timeout)
        pieces: list[RangeSamples] = []
        try:
            for piece in _cut_pieces(answers, span):
                pieces.append(piece)
                yield replace(span, end=float(piece.t[-1])), piece
        except GeneratorExit:
            motion = self._stop(motion, time.time() - start)
            raise
        except grpc.RpcError as error:
            raise from_rpc_error(error) from error
        finally:
            stop.set()
            answers.cancel()
            self.motions.append(motion)
            self.measured.append(RangeSamples.concatenate(pieces))
        if not pieces:
            raise Unavailable("The gateway gave no sample of the scan.", "Look at the gateway's log and its device.")

    def _stop(self, motion: Motion, elapsed: float) -> Motion:
        """Leaves the motion `elapsed` seconds after its start, upwards; the motion that was made. Waits for its end."""
        now = min(elapsed * self._pace, float(motion.path.t[-1]))
        stopped = motion.stopped(now)
        lift = Trajectory(stopped.path.t[stopped.path.t >= now], stopped.path.base_T_tip[stopped.path.t >= now])
        seconds = lift.duration / self._pace
        self._finger.play(Trajectory((lift.t - lift.t[0]) / self._pace, lift.base_T_tip), time.time())
        time.sleep(seconds)
        return stopped

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


def _tell_poses(device: str, path: Trajectory, start: float, stop: threading.Event) -> Iterator[pb.StreamPointsRequest]:
    """Tells the gateway each pose when the tip is there, until `stop`: at POSE_RATE, and at the corners of its path."""
    yield pb.StreamPointsRequest(device=device)
    times = np.union1d(np.arange(0.0, path.duration, 1.0 / POSE_RATE), path.t)
    sent = 0
    while sent < len(times) and not stop.wait(max(0.0, start + times[sent] - time.time())):
        due = max(sent + 1, int(np.searchsorted(start + times, time.time(), side="right")))
        now = times[sent:due]
        yield pb.StreamPointsRequest(
            tip_poses=[
                pb.TipPose(t=start + t, base_t_tip=common_pb2.Pose(matrix=pose.ravel()))
                for t, pose in zip(now, path.at(now), strict=True)
            ]
        )
        sent = due


def _cut_pieces(answers: Iterator[Any], span: GatewaySpan) -> Iterator[RangeSamples]:
    """The samples within the span, in pieces of PIECE seconds or more, each in the order of time."""
    batches: list[RangeSamples] = []
    for answer in answers:
        samples = samples_from_proto(answer.samples)
        batches.append(samples.select((samples.t >= span.start) & (samples.t <= span.end)))
        piece = RangeSamples.merge(batches)
        if len(piece) and piece.t[-1] - piece.t[0] >= PIECE:
            yield piece
            batches = []
    piece = RangeSamples.merge(batches)
    if len(piece):
        yield piece
