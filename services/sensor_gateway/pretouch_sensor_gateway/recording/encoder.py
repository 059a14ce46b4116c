"""Encodes measurements, configurations and events as entries of a recording."""

from __future__ import annotations

import struct

from pretouch.errors import InvalidInput
from pretouch.geometry import Pose
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.v1.recording_pb2 import RecordedTipPoses
from pretouch.wire.common import pose_from_proto
from pretouch_sensor_gateway.fusion import FusedSamples
from pretouch_sensor_gateway.recording import foxglove
from pretouch_sensor_gateway.recording.channels import Channel, Entry

_DOUBLE = struct.Struct("<d")
_CLOUD_EVERY = 90_000_000
"""ns from one point cloud of the ranges to the next: ten a second are enough to look at, at whatever rate they come."""
_LATEST = 2**64 // 10**9
"""The latest Unix time, s, that MCAP can hold, in the year 2554."""


class Encoder:
    """Serialises one device's measurements, configuration and events; times are Unix times, ns.

    An invalid time (not finite, before 1970, beyond MCAP's latest) is replaced by the one before it.
    """

    def __init__(self, device: str) -> None:
        self._device = device
        self._time = self._drawn = 0
        self._undrawn: list[pb.RangeBatch] = []
        self.set_configuration(pb.DeviceConfiguration())

    def encode_batch(self, batch: pb.RangeBatch) -> list[Entry]:
        """The batch itself at the time of its last measurement, and a point cloud, if it is time for one."""
        time = self.nanoseconds(_last_time(batch))
        entries = [Entry(Channel.RANGES, time, batch.SerializeToString())]
        self._undrawn.append(batch)
        if abs(time - self._drawn) >= _CLOUD_EVERY:
            entries += self.encode_cloud()
        return entries

    def encode_cloud(self) -> list[Entry]:
        """A point cloud of the batches since the one before, if there are any."""
        undrawn, self._undrawn, self._drawn = self._undrawn, [], self._time
        if not undrawn:
            return []
        return [Entry(Channel.POINTS, self._time, self._clouds.encode(undrawn, self._time))]

    def set_configuration(self, configuration: pb.DeviceConfiguration) -> None:
        """Computes point clouds by `configuration` from now on; without poses there is one module, at the tip."""
        self._configuration = configuration
        try:
            poses = [pose_from_proto(pose, "tip_t_module") for pose in configuration.tip_t_module]
        except InvalidInput:
            poses = []
        self._tip_T_module = poses or [Pose.identity()]
        self._clouds = foxglove.PointClouds(self._device, self._tip_T_module)

    def encode_configuration(self, time: int) -> list[Entry]:
        """The present configuration, and the coordinate frames of its modules."""
        return [
            Entry(Channel.CONFIGURATION, time, self._configuration.SerializeToString()),
            Entry(Channel.TRANSFORMS, time, foxglove.encode_modules(self._device, self._tip_T_module, time)),
        ]

    def encode_tip_poses(self, poses: RecordedTipPoses) -> list[Entry]:
        """The poses themselves, and the last of them as a coordinate frame, at its time."""
        last = poses.tip_poses[-1]
        time = self.nanoseconds(last.t)
        tip = foxglove.encode_tip(self._device, pose_from_proto(last.base_t_tip, "base_t_tip"), time)
        return [
            Entry(Channel.TIP_POSES, time, poses.SerializeToString()),
            Entry(Channel.TRANSFORMS, time, tip),
        ]

    def encode_points(self, fused: FusedSamples) -> Entry:
        """A point cloud in base, at the time of its last sample."""
        time = self.nanoseconds(float(fused.samples.t[-1]))
        return Entry(Channel.BASE_POINTS, time, foxglove.encode_base_points(fused, time))

    def encode_event(self, text: str, time: int) -> Entry:
        """An event."""
        return Entry(Channel.LOG, time, foxglove.encode_log(self._device, text, time))

    def nanoseconds(self, seconds: float) -> int:
        """A Unix time, s, in ns as MCAP has it."""
        if 0 <= seconds < _LATEST:
            self._time = round(seconds * 1e9)
        return self._time


def _last_time(batch: pb.RangeBatch) -> float:
    """NaN if there is none."""
    times = batch.t.data
    return float(_DOUBLE.unpack_from(times, len(times) - 8)[0]) if len(times) >= 8 else float("nan")
