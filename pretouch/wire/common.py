"""Domain types <-> the messages of common.proto. `x_to_proto` packs, `x_from_proto` unpacks and validates."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pretouch.camera import Camera, DepthImage
from pretouch.errors import InvalidInput
from pretouch.estimate import Estimate, Mode, Prior, WeakDirection
from pretouch.geometry import Plane, Pose
from pretouch.mesh_target import MeshTarget
from pretouch.rectangle import RotatedRectangle
from pretouch.scene import Scene
from pretouch.tof import RangeSamples, Scan, Sensor
from pretouch.v1 import common_pb2 as pb

_DTYPES: dict[pb.ScalarType.ValueType, np.dtype[Any]] = {
    pb.SCALAR_TYPE_UINT8: np.dtype("u1"),
    pb.SCALAR_TYPE_UINT16: np.dtype("<u2"),
    pb.SCALAR_TYPE_FLOAT32: np.dtype("<f4"),
    pb.SCALAR_TYPE_FLOAT64: np.dtype("<f8"),
    pb.SCALAR_TYPE_UINT32: np.dtype("<u4"),
}
_NAMED = {dtype.str[1:]: (dtype, number) for number, dtype in _DTYPES.items()}


def array_to_proto(array: NDArray[np.generic], dtype: str) -> pb.Array:
    """Packs `array` as `dtype`: "u1", "u2", "u4", "f4" or "f8"."""
    wire_dtype, number = _NAMED[dtype]
    return pb.Array(data=np.asarray(array, dtype=wire_dtype).tobytes(), shape=array.shape, type=number)


def array_from_proto(message: pb.Array, name: str) -> NDArray[Any]:
    """Unpacks a read-only array.

    Raises:
        InvalidInput: unknown type, or bytes that do not fit shape and type.
    """
    dtype = _DTYPES.get(message.type)
    if dtype is None:
        raise InvalidInput(f"{name} has no scalar type.", "Send the array's type, shape and packed data.")
    shape = tuple(message.shape)
    if len(shape) > 4 or math.prod(shape) * dtype.itemsize != len(message.data):
        raise InvalidInput(
            f"{name} has {len(message.data)} bytes, which do not fill shape {list(shape)} of {dtype} numbers.",
            "Send exactly the shape's product times the type's size, row-major, little-endian.",
        )
    array: NDArray[Any] = np.frombuffer(message.data, dtype=dtype).reshape(shape)
    return array


def pose_to_proto(pose: Pose) -> pb.Pose:
    return pb.Pose(matrix=pose.matrix.ravel())


def pose_from_proto(message: pb.Pose, name: str) -> Pose:
    if len(message.matrix) != 16:
        raise InvalidInput(f"{name} has {len(message.matrix)} numbers, not 16.", "Send a 4x4 row-major matrix.")
    return Pose(np.reshape(message.matrix, (4, 4)))


def camera_to_proto(camera: Camera) -> pb.Camera:
    return pb.Camera(fx=camera.fx, fy=camera.fy, cx=camera.cx, cy=camera.cy)


def camera_from_proto(message: pb.Camera) -> Camera:
    return Camera(message.fx, message.fy, message.cx, message.cy)


def plane_to_proto(plane: Plane) -> pb.Plane:
    return pb.Plane(normal=plane.normal, offset=plane.offset)


def plane_from_proto(message: pb.Plane) -> Plane:
    return Plane(np.array(message.normal), message.offset)


def rectangle_to_proto(rectangle: RotatedRectangle) -> pb.Rectangle:
    return pb.Rectangle(x=rectangle.x, y=rectangle.y, w=rectangle.w, h=rectangle.h, theta=rectangle.theta)


def rectangle_from_proto(message: pb.Rectangle) -> RotatedRectangle:
    return RotatedRectangle(message.x, message.y, message.w, message.h, message.theta)


def scene_to_proto(scene: Scene) -> pb.Scene:
    return pb.Scene(
        depth=array_to_proto(scene.depth.metres, "f4"),
        depth_scale=1.0,
        camera=camera_to_proto(scene.camera),
        base_t_camera=pose_to_proto(scene.base_T_camera),
        mask=array_to_proto(scene.mask, "u1"),
        table=plane_to_proto(scene.table),
    )


def scene_from_proto(message: pb.Scene) -> Scene:
    return Scene(
        DepthImage.from_values(array_from_proto(message.depth, "scene.depth"), message.depth_scale),
        camera_from_proto(message.camera),
        pose_from_proto(message.base_t_camera, "scene.base_t_camera"),
        array_from_proto(message.mask, "scene.mask") != 0,
        plane_from_proto(message.table),
    )


def mesh_to_proto(mesh: MeshTarget) -> pb.MeshTarget:
    return pb.MeshTarget(
        vertices=array_to_proto(mesh.vertices, "f4"),
        faces=array_to_proto(mesh.faces, "u4"),
        base_t_object=pose_to_proto(mesh.base_T_object),
        table=plane_to_proto(mesh.table),
    )


def mesh_from_proto(message: pb.MeshTarget) -> MeshTarget:
    return MeshTarget(
        array_from_proto(message.vertices, "mesh.vertices"),
        array_from_proto(message.faces, "mesh.faces"),
        pose_from_proto(message.base_t_object, "mesh.base_t_object"),
        plane_from_proto(message.table),
    )


def sensor_to_proto(sensor: Sensor) -> pb.Sensor:
    return pb.Sensor(
        range_min=sensor.range_min,
        range_max=sensor.range_max,
        range_std=sensor.range_std,
        beam_half_angle=sensor.beam_half_angle,
        rate=sensor.rate,
        tip_t_module=[pose_to_proto(pose) for pose in sensor.tip_T_module],
    )


def sensor_from_proto(message: pb.Sensor) -> Sensor:
    """Numbers that the message leaves out take the defaults of `Sensor`."""
    given = {field.name: value for field, value in message.ListFields() if field.name != "tip_t_module"}
    modules = tuple(pose_from_proto(pose, "sensor.tip_t_module") for pose in message.tip_t_module)
    return Sensor(**given, tip_T_module=modules or (Pose.identity(),))


def prior_to_proto(prior: Prior) -> pb.Prior:
    return pb.Prior(translation_std=prior.translation_std, rotation_std=prior.rotation_std)


def prior_from_proto(message: pb.Prior) -> Prior:
    """Numbers that the message leaves out take the defaults of `Prior`."""
    return Prior(**{field.name: value for field, value in message.ListFields()})


def scan_to_proto(scan: Scan) -> pb.Scan:
    return pb.Scan(
        origins=array_to_proto(scan.origins, "f8"),
        directions=array_to_proto(scan.directions, "f8"),
        ranges=array_to_proto(scan.ranges, "f8"),
    )


def scan_from_proto(message: pb.Scan) -> Scan:
    return Scan(
        array_from_proto(message.origins, "scan.origins"),
        array_from_proto(message.directions, "scan.directions"),
        array_from_proto(message.ranges, "scan.ranges"),
    )


def samples_to_proto(samples: RangeSamples) -> pb.Samples:
    return pb.Samples(
        t=array_to_proto(samples.t, "f8"),
        base_t_tip=array_to_proto(samples.base_T_tip, "f8"),
        range=array_to_proto(samples.range, "f8"),
        status=array_to_proto(samples.status, "u1"),
        module=array_to_proto(samples.module, "u1"),
    )


def samples_from_proto(message: pb.Samples) -> RangeSamples:
    return RangeSamples(
        array_from_proto(message.t, "samples.t"),
        array_from_proto(message.base_t_tip, "samples.base_t_tip"),
        array_from_proto(message.range, "samples.range"),
        array_from_proto(message.status, "samples.status"),
        array_from_proto(message.module, "samples.module"),
    )


def estimate_to_proto(estimate: Estimate) -> pb.Estimate:
    return pb.Estimate(
        base_t_correction=pose_to_proto(estimate.base_T_correction),
        centroid=estimate.centroid,
        covariance=estimate.covariance.ravel(),
        expected_error=estimate.expected_error,
        error_quantile=estimate.error_quantile,
        unobservable=[
            pb.WeakDirection(direction=weak.direction, std=weak.std, text=weak.text) for weak in estimate.unobservable
        ],
        inliers=estimate.inliers,
        samples=estimate.samples,
        rmse=estimate.rmse,
        modes=[
            pb.Mode(base_t_correction=pose_to_proto(mode.base_T_correction), weight=mode.weight)
            for mode in estimate.modes
        ],
        fit=estimate.fit,
        sensor_problem=estimate.sensor_problem,
    )


def estimate_from_proto(message: pb.Estimate) -> Estimate:
    return Estimate(
        base_T_correction=pose_from_proto(message.base_t_correction, "estimate.base_t_correction"),
        centroid=np.array(message.centroid),
        covariance=np.reshape(message.covariance, (6, 6)),
        expected_error=message.expected_error,
        error_quantile=message.error_quantile,
        unobservable=tuple(
            WeakDirection(np.array(weak.direction), weak.std, weak.text) for weak in message.unobservable
        ),
        inliers=message.inliers,
        samples=message.samples,
        rmse=message.rmse,
        modes=tuple(
            Mode(pose_from_proto(mode.base_t_correction, "estimate.modes.base_t_correction"), mode.weight)
            for mode in message.modes
        ),
        fit=message.fit if message.HasField("fit") else 1.0,
        sensor_problem=message.sensor_problem,
    )
