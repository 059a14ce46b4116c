"""What a session may state as its sensor, by the calibration of the finger."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from pretouch.geometry import Pose
from pretouch.tof import Sensor
from pretouch_sensor_gateway.calibration.model import EVERYWHERE, Calibration

_LIMIT = 0.1
"""m: what a session's standard deviations may be at most."""


def describe_sensor(
    calibration: Calibration | None, tip_T_module: Sequence[Pose], range_std: float, rate: float
) -> Sensor:
    """The description; what is not known keeps its default.

    The range's limits are those that some module was calibrated to. Its standard deviation is that of calibrated ranges
    in their middle, over the modules; of uncalibrated ones it is what was measured. The half angle is that of a sweep,
    the largest of the modules.

    Args:
        range_std: of recent ranges, m.
        rate: measurements a second.
    """
    modules = () if calibration is None else calibration.modules
    spans = [module.span for module in modules if module.span != EVERYWHERE]
    start = min((span[0] for span in spans), default=Sensor.range_min)
    end = min(max((span[1] for span in spans), default=Sensor.range_max), 10.0)
    if spans and all(module.std for module in modules):
        middle = np.array((start + end) / 2)
        range_std = math.sqrt(np.mean([float(module.std_at(np.clip(middle, *module.span))) ** 2 for module in modules]))
    known = [module.mounting for module in modules if module.mounting is not None]
    angles = [each.half_angle for each in known if "log_half_angle" not in each.unobserved]
    bias = None if calibration is None else calibration.bias_std
    return Sensor(
        range_min=start,
        range_max=end,
        range_std=min(max(range_std, 1e-6), _LIMIT),
        beam_half_angle=max((angle for angle in angles if angle < math.pi / 4), default=Sensor.beam_half_angle),
        rate=min(rate, 10_000.0),
        tip_T_module=tuple(tip_T_module),
        range_bias_std=Sensor.range_bias_std if bias is None else min(bias, _LIMIT),
    )
