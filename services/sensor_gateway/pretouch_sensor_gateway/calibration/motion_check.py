"""Checks whether the plate stood still while a module was read."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pretouch.geometry import Array
from pretouch_sensor_gateway.calibration.readings import find_step, noise_std, reject_outliers

_LEAST_SHIFT = 0.001
"""m: a smaller shift is ignored."""
_SHIFT_ERRORS = 6.0
"""Standard errors of the difference of two means: of a million still plates, none is refused."""
_LEAST_SHAKE = 0.002
_SHAKE = 3.0
"""How many times the largest noise elsewhere; a module's own noise grows less from one distance to the next."""


def describe_motion(readings: Array, elsewhere: Sequence[float]) -> str:
    """How the readings (n,), m, in the order of time, n >= 10, show that the plate moved; "" if they do not.

    A plate that was moved: the means of the three thirds differ by more than the noise within them explains. A plate
    that was shaken: the noise is much larger than `elsewhere`, the standard deviations in m at other distances.
    """
    step = find_step([readings])
    points = [reject_outliers(0.0, third, step) for third in np.array_split(readings, 3)]
    means = [point.mean for point in points]
    shift = max(means) - min(means)
    within = float(np.sqrt(np.mean([point.std**2 for point in points])))
    if shift > max(_LEAST_SHIFT, _SHIFT_ERRORS * within * np.sqrt(2 / (len(readings) / 3))):
        return f"its readings moved by {1000 * shift:.1f} mm"
    std = noise_std(readings)
    if elsewhere and std > max(_LEAST_SHAKE, _SHAKE * max(elsewhere)):
        return f"its noise is {1000 * std:.1f} mm, at most {1000 * max(elsewhere):.1f} mm elsewhere"
    return ""
