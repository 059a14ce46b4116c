"""Domain types <-> the messages of common.proto. `x_to_proto` packs, `x_from_proto` unpacks and validates."""

from __future__ import annotations

import math
from dataclasses import is_dataclass
from typing import Annotated, Any, TypeVar, get_args, get_origin

import numpy as np
from google.protobuf.message import Message
from numpy.typing import NDArray

from pretouch.camera import Camera, DepthImage
from pretouch.errors import InvalidInput
from pretouch.estimate import Estimate
from pretouch.geometry import Plane, Pose
from pretouch.mesh_target import MeshTarget
from pretouch.prior import AnyPrior, PosePrior, Prior
from pretouch.rectangle import RotatedRectangle
from pretouch.scene import Scene
from pretouch.tof import RangeSamples, Scan, Sensor
from pretouch.v1 import common_pb2 as pb
from pretouch.v1 import orchestrator_pb2, registrar_pb2
from pretouch.wire.contract import contract_fields

_DTYPES: dict[pb.ScalarType.ValueType, np.dtype[Any]] = {
    pb.SCALAR_TYPE_UINT8: np.dtype("u1"),
    pb.SCALAR_TYPE_UINT16: np.dtype("<u2"),
    pb.SCALAR_TYPE_FLOAT32: np.dtype("<f4"),
    pb.SCALAR_TYPE_FLOAT64: np.dtype("<f8"),
    pb.SCALAR_TYPE_UINT32: np.dtype("<u4"),
}
_Owner = TypeVar("_Owner")
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


def contract_to_proto(value: Any) -> dict[str, Any]:
    """The fields of the message of a contract type, for the message's constructor: see `pretouch.wire.contract`."""
    return {field.name.lower(): _value_to_proto(getattr(value, field.name)) for field in contract_fields(type(value))}


def contract_from_proto(message: Message, owner: type[_Owner], path: str) -> _Owner:
    """The contract type `owner` from its message; fields left out take their defaults. `path` names it in errors.

    Raises:
        InvalidInput: a missing field, a wrong number of numbers, a value out of its limits.
        Malformed: a number that is not finite.
    """
    given: dict[str, Any] = {}
    for field in contract_fields(owner):
        name = field.name.lower()
        value = getattr(message, name)
        has_presence = message.DESCRIPTOR.fields_by_name[name].has_presence
        left_out = not message.HasField(name) if has_presence else not value and not field.required
        if not left_out:
            given[field.name] = _value_from_proto(value, field.type, f"{path}.{name}")
        elif type(None) in get_args(field.type):
            given[field.name] = None
        elif field.required:
            raise InvalidInput(f"{path}.{name} is missing.", f"Send {path}.{name}.")
    return owner(**given)


def _value_to_proto(value: Any) -> Any:
    match value:
        case Pose():
            return pose_to_proto(value)
        case np.ndarray():
            return value.ravel()
        case tuple():
            return [_value_to_proto(item) for item in value]
        case _:
            return contract_to_proto(value) if is_dataclass(value) else value


def _value_from_proto(value: Any, wanted: Any, path: str) -> Any:
    if type(None) in get_args(wanted):
        wanted = get_args(wanted)[0]
    if get_origin(wanted) is tuple:
        return tuple(_value_from_proto(item, get_args(wanted)[0], f"{path}[{k}]") for k, item in enumerate(value))
    if type(None) in get_args(wanted):
        return _value_from_proto(value, get_args(wanted)[0], path)
    if get_origin(wanted) is Annotated:
        return _array_from_numbers(value, wanted.__metadata__[0], path)
    if wanted is Pose:
        return pose_from_proto(value, path)
    return contract_from_proto(value, wanted, path) if isinstance(wanted, type) and is_dataclass(wanted) else value


def _array_from_numbers(values: Any, shape: tuple[int | None, ...], path: str) -> NDArray[Any]:
    """The numbers, row-major, as an array of `shape`, of which None stands for any length."""
    count = math.prod(length or 1 for length in shape)
    if len(values) != count and (None not in shape or len(values) % count):
        wanted = f"a multiple of {count}" if None in shape else str(count)
        raise InvalidInput(f"{path} has {len(values)} numbers, not {wanted}.", f"Send {wanted} numbers for {path}.")
    return np.reshape(values, [-1 if length is None else length for length in shape])


def scene_to_proto(scene: Scene) -> pb.Scene:
    return pb.Scene(
        depth=array_to_proto(scene.depth.metres, "f4"),
        depth_scale=1.0,
        camera=pb.Camera(**contract_to_proto(scene.camera)),
        base_t_camera=pose_to_proto(scene.base_T_camera),
        mask=array_to_proto(scene.mask, "u1"),
        table=pb.Plane(**contract_to_proto(scene.table)),
    )


def scene_from_proto(message: pb.Scene) -> Scene:
    return Scene(
        DepthImage.from_values(array_from_proto(message.depth, "scene.depth"), message.depth_scale),
        contract_from_proto(message.camera, Camera, "scene.camera"),
        pose_from_proto(message.base_t_camera, "scene.base_t_camera"),
        array_from_proto(message.mask, "scene.mask") != 0,
        contract_from_proto(message.table, Plane, "scene.table"),
    )


def mesh_to_proto(mesh: MeshTarget) -> pb.MeshTarget:
    return pb.MeshTarget(
        vertices=array_to_proto(mesh.vertices, "f4"),
        faces=array_to_proto(mesh.faces, "u4"),
        base_t_object=pose_to_proto(mesh.base_T_object),
        table=pb.Plane(**contract_to_proto(mesh.table)),
    )


def mesh_from_proto(message: pb.MeshTarget) -> MeshTarget:
    return MeshTarget(
        array_from_proto(message.vertices, "mesh.vertices"),
        array_from_proto(message.faces, "mesh.faces"),
        pose_from_proto(message.base_t_object, "mesh.base_t_object"),
        contract_from_proto(message.table, Plane, "mesh.table"),
    )


def rectangle_to_proto(rectangle: RotatedRectangle) -> pb.Rectangle:
    return pb.Rectangle(**contract_to_proto(rectangle))


def rectangle_from_proto(message: pb.Rectangle) -> RotatedRectangle:
    return contract_from_proto(message, RotatedRectangle, "rectangle")


def sensor_to_proto(sensor: Sensor) -> pb.Sensor:
    return pb.Sensor(**contract_to_proto(sensor))


def sensor_from_proto(message: pb.Sensor) -> Sensor:
    return contract_from_proto(message, Sensor, "sensor")


def prior_to_proto(prior: AnyPrior | None) -> dict[str, Any]:
    """The field of a message with `prior` and `pose_prior`, for the message's constructor; none for None."""
    match prior:
        case Prior():
            return {"prior": pb.Prior(**contract_to_proto(prior))}
        case PosePrior():
            return {"pose_prior": pb.PosePrior(**contract_to_proto(prior))}
        case None:
            return {}


def prior_from_proto(
    message: orchestrator_pb2.CreateSessionRequest | registrar_pb2.RegistrationSettings,
) -> AnyPrior | None:
    """The prior of a message with `prior` and `pose_prior`; None if neither is there.

    Raises:
        InvalidInput: both are there, or a value out of its limits.
    """
    if message.HasField("pose_prior"):
        if message.HasField("prior"):
            raise InvalidInput("Both prior and pose_prior are given.", "Send one of them.")
        return contract_from_proto(message.pose_prior, PosePrior, "pose_prior")
    return contract_from_proto(message.prior, Prior, "prior") if message.HasField("prior") else None


def estimate_to_proto(estimate: Estimate) -> pb.Estimate:
    return pb.Estimate(**contract_to_proto(estimate))


def estimate_from_proto(message: pb.Estimate) -> Estimate:
    return contract_from_proto(message, Estimate, "estimate")


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
