"""Encodes a device's measurements as Foxglove messages.

Coordinate frames are named after the device, `<device>/tip` and `<device>/module_<k>`, so that recordings of several
fingers can be viewed together; they share `base`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.Pose_pb2 import Pose as FoxglovePose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp
from numpy.typing import NDArray

from pretouch.geometry import Pose
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch_sensor_gateway.fusion import FusedSamples

BASE_FRAME = "base"
_CODES = [("module", "u1"), ("status", "u1"), ("flags", "u1")]
_POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), *_CODES])
_BASE_POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("std", "<f4"), *_CODES])
_TYPES = {"f": PackedElementField.FLOAT32, "u": PackedElementField.UINT8}


class PointClouds:
    """Encodes batches as point clouds in the tip's coordinate frame.

    Args:
        device: after which the coordinate frames are named.
        tip_T_module: pose of each module in the tip's coordinate frame; further modules are left out.
    """

    def __init__(self, device: str, tip_T_module: Sequence[Pose]) -> None:
        matrices = np.stack([pose.matrix for pose in tip_T_module])
        self._origins, self._directions = matrices[:, :3, 3], matrices[:, :3, 2]
        self._layout = _layout(_tip_frame(device), _POINT)

    def encode(self, batches: Sequence[pb.RangeBatch], time: int) -> bytes:
        """A serialised PointCloud of every range of the batches, those with a bad status too.

        Inconsistent batches are left out. Misses alone give an empty cloud, so that the previous one disappears.
        """
        return _cloud(self._layout, np.concatenate([self._points(batch) for batch in batches]), time)

    def _points(self, batch: pb.RangeBatch) -> NDArray[np.void]:
        shape = tuple(batch.range.shape)
        count = math.prod(shape)
        arrays = batch.range.data, batch.status.data, batch.flags.data
        if len(shape) != 2 or [*map(len, arrays)] != [8 * count, count, count]:
            return np.empty(0, _POINT)
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
        return np.asarray(points[np.isfinite(ranges)])


def encode_base_points(fused: FusedSamples, time: int) -> bytes:
    """A serialised PointCloud of the samples' points in base; misses are left out."""
    points = np.empty(len(fused.points), _BASE_POINT)
    points["x"], points["y"], points["z"] = fused.points.T
    points["std"] = fused.std
    points["module"], points["status"] = fused.samples.module, fused.samples.status
    points["flags"] = fused.flags
    return _cloud(_layout(BASE_FRAME, _BASE_POINT), points[np.isfinite(fused.std)], time)


def encode_modules(device: str, tip_T_module: Sequence[Pose], time: int) -> bytes:
    """A serialised FrameTransforms from the tip's coordinate frame to the modules'."""
    frames = {f"{device}/module_{k}": pose for k, pose in enumerate(tip_T_module)}
    return _transforms(_tip_frame(device), frames, time)


def encode_tip(device: str, base_T_tip: Pose, time: int) -> bytes:
    """A serialised FrameTransforms from base to the tip's coordinate frame."""
    return _transforms(BASE_FRAME, {_tip_frame(device): base_T_tip}, time)


def encode_log(device: str, text: str, time: int) -> bytes:
    """A serialised Log of an event."""
    return Log(timestamp=_stamp(time), level=Log.INFO, message=text, name=device).SerializeToString()


def _transforms(parent: str, frames: Mapping[str, Pose], time: int) -> bytes:
    message = FrameTransforms()
    for child, pose in frames.items():
        x, y, z, w = pose.quaternion
        message.transforms.add(
            timestamp=_stamp(time),
            parent_frame_id=parent,
            child_frame_id=child,
            translation=Vector3(x=pose.translation[0], y=pose.translation[1], z=pose.translation[2]),
            rotation=Quaternion(x=x, y=y, z=z, w=w),
        )
    return message.SerializeToString()


@cache
def _layout(frame: str, point: np.dtype[np.void]) -> bytes:
    """What never changes of the clouds in a frame, serialised."""
    assert point.fields is not None
    return PointCloud(
        frame_id=frame,
        pose=FoxglovePose(position=Vector3(), orientation=Quaternion(w=1.0)),
        point_stride=point.itemsize,
        fields=[
            PackedElementField(name=name, offset=offset, type=_TYPES[kind.kind])
            for name, (kind, offset, *_) in point.fields.items()
        ],
    ).SerializeToString()


def _cloud(layout: bytes, points: NDArray[np.void], time: int) -> bytes:
    """Serialised messages that follow one another are read as one."""
    return layout + PointCloud(timestamp=_stamp(time), data=points.tobytes()).SerializeToString()


def _tip_frame(device: str) -> str:
    return f"{device}/tip"


def _stamp(time: int) -> Timestamp:
    return Timestamp(seconds=time // 10**9, nanos=time % 10**9)
