"""The gateway's own types as messages of sensor_gateway.proto."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.wire.common import array_to_proto, samples_to_proto
from pretouch_sensor_gateway.device import Device, DeviceState
from pretouch_sensor_gateway.fusion import Fused
from pretouch_sensor_gateway.subscription import TimedFrame

_STATES = {
    DeviceState.CONNECTING: pb.DEVICE_STATE_CONNECTING,
    DeviceState.STREAMING: pb.DEVICE_STATE_STREAMING,
    DeviceState.SILENT: pb.DEVICE_STATE_SILENT,
}


def device_to_proto(device: Device) -> pb.Device:
    status = device.status()
    return pb.Device(
        name=device.name,
        port=device.port,
        state=_STATES[status.state],
        frames=status.frames,
        bad_frames=status.bad_frames,
        lost_frames=status.lost_frames,
        problem=status.problem,
    )


def ranges_to_proto(frames: Sequence[TimedFrame], lost: int) -> pb.StreamRangesResponse:
    """One entry for each module of each frame."""
    return pb.StreamRangesResponse(
        t=array_to_proto(np.array([frame.t for frame in frames for _ in frame.ranges]), "f8"),
        range=array_to_proto(np.array([metres for frame in frames for metres in frame.ranges]), "f8"),
        status=array_to_proto(np.array([code for frame in frames for code in frame.status]), "u1"),
        module=array_to_proto(np.array([k for frame in frames for k in range(len(frame.ranges))]), "u1"),
        sequence=frames[0].sequence,
        lost=lost,
    )


def points_to_proto(fused: Fused, lost: int) -> pb.StreamPointsResponse:
    return pb.StreamPointsResponse(
        samples=samples_to_proto(fused.samples),
        points=array_to_proto(fused.points, "f8"),
        lost=lost,
        unposed=fused.unposed,
    )
