"""Calibrations as messages of sensor_gateway.proto."""

from __future__ import annotations

from pretouch.errors import InvalidInput
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.wire.reader import prefix_errors
from pretouch_sensor_gateway.calibration.model import EVERYWHERE, MAX_MODULES, Calibration, ModuleCalibration


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
                )
            )
    with prefix_errors("calibration"):
        bias_std = message.bias_std if message.HasField("bias_std") else None
        return Calibration(message.serial, message.warm_up, tuple(modules), bias_std)
