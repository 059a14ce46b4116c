"""Tip poses as a robot sends them, on its own clock, onto a path on the gateway's."""

from __future__ import annotations

import math

from pretouch.errors import InvalidInput
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.v1.recording_pb2 import RecordedTipPoses
from pretouch.wire.common import pose_from_proto
from pretouch_sensor_gateway.clock.clock_offset import ClockOffset
from pretouch_sensor_gateway.device import Device
from pretouch_sensor_gateway.history import SPAN
from pretouch_sensor_gateway.live_pose_check import LivePoseCheck
from pretouch_sensor_gateway.pose_path import PosePath


class TipPoseReceiver:
    """Takes the messages of one StreamPoints call.

    Args:
        device: whose clock and history.
        first: the call's first message, which says how the robot's clock is known.

    Attributes:
        path: the poses, on the gateway's clock. It is in the device's history from its first pose on.
        out_of_order: poses dropped so far because one of a later time had come before.

    Raises:
        InvalidInput: the clock offset is given in two ways, or is no number.
    """

    def __init__(self, device: Device, first: pb.StreamPointsRequest) -> None:
        if first.HasField("clock_offset") and first.HasField("robot_clock"):
            raise InvalidInput(
                "The call states clock_offset, and robot_clock to estimate it.", "Send one of the two, or neither."
            )
        if not math.isfinite(first.clock_offset):
            raise InvalidInput("clock_offset is not a finite number.", "Send the robot's clock minus the gateway's, s.")
        self.path = PosePath()
        self.out_of_order = 0
        self._device = device
        self._stated = first.clock_offset
        self._estimate = ClockOffset() if first.HasField("robot_clock") else None
        self._check = LivePoseCheck()
        self._call = device.count_call()
        self._modules = first.tip_t_module

    @property
    def clock_offset(self) -> float:
        """The robot's clock minus the gateway's, s; 0 while it is to be estimated and not known."""
        if self._estimate is None:
            return self._stated
        return self._estimate.value if self._estimate.known else 0.0

    @property
    def clock_offset_std(self) -> float:
        """One standard deviation of `clock_offset`, s; 0 if it was stated."""
        return self._estimate.std if self._estimate is not None and self._estimate.known else 0.0

    def add(self, message: pb.StreamPointsRequest) -> bool:
        """Takes a message; returns whether it wants to be answered at once.

        Raises:
            InvalidInput: its poses cannot be used. What was sent before is then forgotten, if the robot's clock is the
                reason.
        """
        now = self._device.now()
        if message.HasField("robot_clock"):
            self._learn(message.robot_clock, now)
        if message.tip_poses:
            self._add_poses(message, now)
        return message.HasField("robot_clock") and not message.tip_poses

    def _learn(self, clock: pb.RobotClock, now: float) -> None:
        if self._estimate is None:
            raise InvalidInput(
                "A later message tells robot_clock, and the first did not.",
                "Send robot_clock in the first, too.",
            )
        if clock.gateway_now and not self._estimate.add(clock.gateway_now, clock.received, clock.now, now):
            raise InvalidInput(
                f"robot_clock tells of a response of {clock.gateway_now:.6f} s, received at {clock.received:.6f} s, in "
                f"a message sent at {clock.now:.6f} s that came at {now:.6f} s: that is no possible order.",
                "Send as gateway_now the `now` of the last response, as received the robot's clock when it came, and "
                "as now the robot's clock when the message is sent.",
            )

    def _add_poses(self, message: pb.StreamPointsRequest, now: float) -> None:
        if self._estimate is not None and not self._estimate.known:
            raise InvalidInput(
                "Tip poses came before the robot's clock is known.",
                "Send robot_clock alone first, wait for the response, and send its `now` as robot_clock.gateway_now.",
            )
        offset = self.clock_offset
        times = [tip.t - offset for tip in message.tip_poses]
        for t, tip in zip(times, message.tip_poses, strict=True):
            if not (math.isfinite(t) and abs(t - now) <= SPAN):
                raise InvalidInput(
                    f"A tip pose is of {tip.t:.3f} s, not within {SPAN:g} s of the gateway's {now + offset:.3f} s.",
                    "Send Unix time in seconds by the gateway's clock, which GetStatus tells, or clock_offset or "
                    "robot_clock with times by the robot's own.",
                )
        try:
            self._check.observe(min(times), max(times), now, offset)
        except InvalidInput:
            self._device.history.remove_path(self.path)
            raise
        recorded = RecordedTipPoses(call=self._call, tip_t_module=self._modules, time_std=self.clock_offset_std)
        for t, tip in zip(times, message.tip_poses, strict=True):
            pose = pose_from_proto(tip.base_t_tip, "base_t_tip")
            if self.path.end is None:
                self._device.history.add_path(self.path)
            if self.path.append(t, pose):
                recorded.tip_poses.add(t=t, base_t_tip=tip.base_t_tip)
            else:
                self.out_of_order += 1
        self._device.record_tip_poses(recorded)
