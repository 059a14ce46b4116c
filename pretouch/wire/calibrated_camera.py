"""Domain types <-> the messages of calibrated_camera.proto."""

from __future__ import annotations

from pretouch.calibrated_camera import CalibratedCamera, CameraSummary
from pretouch.v1 import calibrated_camera_pb2 as pb
from pretouch.wire.common import contract_from_proto, contract_to_proto


def camera_to_proto(camera: CalibratedCamera) -> pb.CalibratedCamera:
    return pb.CalibratedCamera(**contract_to_proto(camera))


def camera_from_proto(message: pb.CalibratedCamera) -> CalibratedCamera:
    return contract_from_proto(message, CalibratedCamera, "camera")


def camera_summary_to_proto(camera: CameraSummary) -> pb.CameraSummary:
    return pb.CameraSummary(**contract_to_proto(camera))


def camera_summary_from_proto(message: pb.CameraSummary) -> CameraSummary:
    return contract_from_proto(message, CameraSummary, "camera")
