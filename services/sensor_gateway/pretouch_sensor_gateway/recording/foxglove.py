"""Encodes a device's measurements as Foxglove messages.

Coordinate frames are named after the device, `<device>/tip` and `<device>/module_<k>`, so that recordings of several
fingers can be viewed together.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.Pose_pb2 import Pose as FoxglovePose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp

from pretouch.geometry import Pose
from pretouch.v1 import sensor_gateway_pb2 as pb

_FLOAT32, _UINT8 = PackedElementField.FLOAT32, PackedElementField.UINT8
_FIELDS = (
    ("x", "<f4", _FLOAT32),
    ("y", "<f4", _FLOAT32),
    ("z", "<f4", _FLOAT32),
    ("module", "u1", _UINT8),
    ("status", "u1", _UINT8),
    ("flags", "u1", _UINT8),
)
_POINT = np.dtype([(name, kind) for name, kind, _ in _FIELDS])


class PointClouds:
    """Encodes batches as point clouds in the tip's coordinate frame.

    Args:
        device: after which the coordinate frames are named.
        tip_T_module: pose of each module in the tip's coordinate frame; further modules are left out.
    """

    def __init__(self, device: str, tip_T_module: Sequence[Pose]) -> None:
        matrices = np.stack([pose.matrix for pose in tip_T_module])
        self._origins, self._directions = matrices[:, :3, 3], matrices[:, :3, 2]
        self._unchanging = PointCloud(
            frame_id=tip_frame(device),
            pose=FoxglovePose(position=Vector3(), orientation=Quaternion(w=1.0)),
            point_stride=_POINT.itemsize,
            fields=[
                PackedElementField(name=name, offset=_POINT.fields[name][1], type=kind)  # type: ignore[index]
                for name, _, kind in _FIELDS
            ],
        ).SerializeToString()

    def encode(self, batch: pb.RangeBatch, time: int) -> bytes | None:
        """A serialised PointCloud of every range of the batch, those with a bad status too.

        None for an inconsistent batch. A batch of misses gives an empty cloud, so that the previous one disappears.
        """
        shape = tuple(batch.range.shape)
        count = math.prod(shape)
        arrays = batch.range.data, batch.status.data, batch.flags.data
        if len(shape) != 2 or [*map(len, arrays)] != [8 * count, count, count]:
            return None
        ranges, status, flags = (
            np.frombuffer(data, kind).reshape(shape)[:, : len(self._origins)]
            for data, kind in zip(arrays, ("<f8", "u1", "u1"), strict=True)
        )
        modules = ranges.shape[1]
        points = np.empty(ranges.shape, _POINT)
        with np.errstate(over="ignore", invalid="ignore"):  # a range that no float32 holds is drawn at infinity
            positions = self._origins[:modules] + ranges[..., None] * self._directions[:modules]
            points["x"], points["y"], points["z"] = positions.T.swapaxes(1, 2)
        points["module"] = np.arange(modules)
        points["status"], points["flags"] = status, flags
        seen = points[np.isfinite(ranges)]
        # Serialised messages that follow one another are read as one, so what never changes is serialised once.
        return self._unchanging + PointCloud(timestamp=_stamp(time), data=seen.tobytes()).SerializeToString()


def encode_transforms(device: str, tip_T_module: Sequence[Pose], time: int) -> bytes:
    """A serialised FrameTransforms from the tip's coordinate frame to the modules'."""
    message = FrameTransforms()
    for k, pose in enumerate(tip_T_module):
        x, y, z, w = pose.quaternion
        message.transforms.add(
            timestamp=_stamp(time),
            parent_frame_id=tip_frame(device),
            child_frame_id=f"{device}/module_{k}",
            translation=Vector3(x=pose.translation[0], y=pose.translation[1], z=pose.translation[2]),
            rotation=Quaternion(x=x, y=y, z=z, w=w),
        )
    return message.SerializeToString()


def encode_log(device: str, text: str, time: int) -> bytes:
    """A serialised Log of an event."""
    return Log(timestamp=_stamp(time), level=Log.INFO, message=text, name=device).SerializeToString()


def tip_frame(device: str) -> str:
    return f"{device}/tip"


def _stamp(time: int) -> Timestamp:
    return Timestamp(seconds=time // 10**9, nanos=time % 10**9)
