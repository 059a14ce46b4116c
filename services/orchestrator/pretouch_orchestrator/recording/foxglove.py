"""Geometry as Foxglove's messages.

Frames are called `base`, `camera` (as the client believes it), `corrected_camera`, `object`, and `beam`: the finger's
latest beam, z along it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.Pose_pb2 import Pose as FoxglovePose
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp
from numpy.typing import NDArray

from pretouch.estimate import Estimate
from pretouch.geometry import Array, Matrix6, Pose
from pretouch.scene import Scene

BASE = "base"
_FIELDS = [PackedElementField(name=name, offset=4 * k, type=PackedElementField.FLOAT32) for k, name in enumerate("xyz")]
_IDENTITY = FoxglovePose(position=Vector3(), orientation=Quaternion(w=1.0))
_MOST_MILLIMETRES = 65_534
_UPWARDS = 1e-6
"""Of a quaternion before it is made a unit: the direction is up, half a turn from down about any axis."""


def stamp(time: int) -> Timestamp:
    """Unix time, ns."""
    return Timestamp(seconds=time // 10**9, nanos=time % 10**9)


def point(p: Array) -> Point3:
    return Point3(x=p[0], y=p[1], z=p[2])


def vector(v: Array) -> Vector3:
    return Vector3(x=v[0], y=v[1], z=v[2])


def pose_message(pose: Pose) -> FoxglovePose:
    x, y, z, w = pose.quaternion
    return FoxglovePose(position=vector(pose.translation), orientation=Quaternion(x=x, y=y, z=z, w=w))


def color(rgb: tuple[float, float, float], opacity: float = 1.0) -> Color:
    return Color(r=rgb[0], g=rgb[1], b=rgb[2], a=opacity)


def cloud(points: Array, time: int) -> PointCloud:
    """Points (n, 3), m, in base, as float32."""
    data = np.asarray(points, dtype="<f4").tobytes()
    return PointCloud(timestamp=stamp(time), frame_id=BASE, pose=_IDENTITY, point_stride=12, fields=_FIELDS, data=data)


def transforms(base_T_frames: Mapping[str, FoxglovePose], time: int) -> FrameTransforms:
    """Frames in base, by name."""
    message = FrameTransforms()
    for name, pose in base_T_frames.items():
        message.transforms.add(
            timestamp=stamp(time),
            parent_frame_id=BASE,
            child_frame_id=name,
            translation=pose.position,
            rotation=pose.orientation,
        )
    return message


def path(poses: Sequence[FoxglovePose], time: int) -> PosesInFrame:
    """Poses in base."""
    return PosesInFrame(timestamp=stamp(time), frame_id=BASE, poses=poses)


def beam_poses(origins: Array, directions: Array) -> list[FoxglovePose]:
    """Frames at the starts (n, 3), m, of beams with z along their directions (n, 3): half a turn about x, which points
    z down, then the smallest turn to the direction. The turn about a beam is not known.
    """
    dx, dy, dz = (directions / np.linalg.norm(directions, axis=1, keepdims=True)).T
    quaternions = np.stack([1 - dz, np.zeros_like(dz), dx, -dy], axis=-1)
    lengths = np.linalg.norm(quaternions, axis=1, keepdims=True)
    quaternions = np.where(lengths < _UPWARDS, (0.0, 0.0, 0.0, 1.0), quaternions / np.maximum(lengths, _UPWARDS))
    return [
        FoxglovePose(position=Vector3(x=p[0], y=p[1], z=p[2]), orientation=Quaternion(x=q[0], y=q[1], z=q[2], w=q[3]))
        for p, q in zip(origins.tolist(), quaternions.tolist(), strict=True)
    ]


def depth_image(scene: Scene, time: int) -> RawImage:
    """Depth along the optical axis in whole millimetres, `16UC1`; 0: no data."""
    metres = scene.depth.metres
    height, width = metres.shape
    millimetres = np.round(1000 * metres)
    values: NDArray[np.uint16] = np.where(millimetres > _MOST_MILLIMETRES, 0, millimetres).astype("<u2")
    return RawImage(
        timestamp=stamp(time),
        frame_id="camera",
        width=width,
        height=height,
        encoding="16UC1",
        step=2 * width,
        data=values.tobytes(),
    )


def calibration(scene: Scene, time: int) -> CameraCalibration:
    height, width = scene.depth.metres.shape
    c = scene.camera
    k = [c.fx, 0.0, c.cx, 0.0, c.fy, c.cy, 0.0, 0.0, 1.0]
    return CameraCalibration(
        timestamp=stamp(time),
        frame_id="camera",
        width=width,
        height=height,
        distortion_model="plumb_bob",
        D=[0.0] * 5,
        K=k,
        R=np.eye(3).ravel(),
        P=[*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0],
    )


def odometry(base_T_object: Pose, estimate: Estimate, time: int) -> Odometry:
    """The object's pose and its covariance, about the object's own origin, in base axes, translation first."""
    return Odometry(
        timestamp=stamp(time),
        frame_id=BASE,
        body_frame_id="object",
        pose=pose_message(base_T_object),
        pose_covariance=covariance_at(estimate, base_T_object.translation).ravel(),
    )


def covariance_at(estimate: Estimate, origin: Array) -> Matrix6:
    """(6, 6) of the error (translation of `origin`, rotation vector), base axes.

    The estimate's covariance is that of (w, d): the rotation vector, and the displacement of the corrected centroid. A
    point r from it is displaced by d + w x r, to first order.

    Args:
        origin: (3,), m, in base, a point of the object where it is estimated to be.
    """
    x, y, z = origin - estimate.base_T_correction.apply(estimate.centroid)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    to_origin = np.block([[-cross, np.eye(3)], [np.eye(3), np.zeros((3, 3))]])
    return np.asarray(to_origin @ estimate.covariance @ to_origin.T, dtype=np.float64)
