"""Calibrations as messages of sensor_gateway.proto."""

from __future__ import annotations

from pretouch.errors import InvalidInput
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.wire.common import array_from_proto, array_to_proto, pose_from_proto, pose_to_proto
from pretouch.wire.reader import prefix_errors
from pretouch_sensor_gateway.calibration.model import EVERYWHERE, MAX_MODULES, Calibration, ModuleCalibration
from pretouch_sensor_gateway.calibration.mounting import Mounting


def calibration_to_proto(calibration: Calibration) -> pb.Calibration:
    return pb.Calibration(
        serial=calibration.serial,
        warm_up=calibration.warm_up,
        modules=[
            pb.ModuleCalibration(
                offset=module.offset,
                scale=module.scale,
                crosstalk=module.crosstalk,
                std=module.std,
                std_slope=module.std_slope,
                residual=module.residual,
                corrections=[
                    pb.RangeCorrection(distance=place, correction=added) for place, added in module.corrections
                ],
                span=None if module.span == EVERYWHERE else pb.RangeSpan(start=module.span[0], end=module.span[1]),
                mounting=None if module.mounting is None else _mounting_to_proto(module.mounting),
            )
            for module in calibration.modules
        ],
        bias_std=calibration.bias_std,
    )


def calibration_from_proto(message: pb.Calibration) -> Calibration:
    """Requires every number of every module: in proto3 a scale that was left out is a scale of 0.

    Raises:
        InvalidInput: an invalid value, with its path in the detail.
    """
    if len(message.modules) > MAX_MODULES:
        raise InvalidInput(f"calibration has {len(message.modules)} modules.", f"Send at most {MAX_MODULES}.")
    modules = []
    for k, module in enumerate(message.modules):
        with prefix_errors(f"calibration.modules[{k}]"):
            modules.append(
                ModuleCalibration(
                    module.offset,
                    module.scale,
                    module.crosstalk,
                    module.std,
                    module.std_slope,
                    module.residual,
                    tuple((pair.distance, pair.correction) for pair in module.corrections),
                    (module.span.start, module.span.end) if module.HasField("span") else EVERYWHERE,
                    _mounting_from_proto(module.mounting) if module.HasField("mounting") else None,
                )
            )
    with prefix_errors("calibration"):
        bias_std = message.bias_std if message.HasField("bias_std") else None
        return Calibration(message.serial, message.warm_up, tuple(modules), bias_std)


def _mounting_to_proto(mounting: Mounting) -> pb.Mounting:
    return pb.Mounting(
        tip_t_module=pose_to_proto(mounting.tip_T_module),
        offset=mounting.offset,
        latency=mounting.latency,
        half_angle=mounting.half_angle,
        decay=mounting.decay,
        covariance=array_to_proto(mounting.covariance, "f8"),
        unobserved=mounting.unobserved,
    )


def _mounting_from_proto(message: pb.Mounting) -> Mounting:
    return Mounting(
        pose_from_proto(message.tip_t_module, "mounting.tip_t_module"),
        message.offset,
        message.latency,
        message.half_angle,
        message.decay,
        array_from_proto(message.covariance, "mounting.covariance"),
        tuple(message.unobserved),
    )
