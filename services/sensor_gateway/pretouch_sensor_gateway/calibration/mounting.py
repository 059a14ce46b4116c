"""Where a module sits, how late its ranges are and how wide it sees, as a sweep told: part of a calibration."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pretouch.errors import InvalidInput
from pretouch.geometry import Array, Pose, frozen_array

PARAMETERS = (
    "tilt_x",
    "tilt_y",
    "origin_x",
    "origin_y",
    "offset",
    "latency",
    "log_half_angle",
    "decay",
    "gain",
    "log_sharpness",
)
"""The order of the covariance."""
MAX_HALF_ANGLE = math.pi / 4


@dataclass(frozen=True, eq=False)
class Mounting:
    """What a sweep tells of one module.

    Attributes:
        tip_T_module: its pose; its turn about the beam, and its place along it, are not observed.
        offset: m that its ranges are too long, and by which its origin lies further along the beam, together.
        latency: s by which its ranges' times are late, beside what the gateway knows of.
        half_angle: rad, where the response is half of that on the axis.
        decay: 1/m: near parts count for more, by exp(-decay * r).
        covariance: (10, 10) of `PARAMETERS`: tilts about x and y (rad) and origin in x and y (m) in the module's frame,
            offset (m), latency (s), logarithm of the half angle, decay (1/m), gain, logarithm of the sharpness.
        unobserved: those of them that the sweep does not tell.

    Raises:
        InvalidInput: a value is beyond what can be, or a name in `unobserved` is not one of `PARAMETERS`.
        Malformed: a value is no finite number.
    """

    tip_T_module: Pose
    offset: float
    latency: float
    half_angle: float
    decay: float
    covariance: Array
    unobserved: tuple[str, ...]

    def __post_init__(self) -> None:
        size = len(PARAMETERS)
        object.__setattr__(self, "covariance", frozen_array(self.covariance, (size, size), "covariance"))
        limits = {"offset": 0.1, "latency": 1.0, "half_angle": MAX_HALF_ANGLE, "decay": 1e4}
        for name, most in limits.items():
            value = float(frozen_array(getattr(self, name), (), name))
            least = -most if name in ("offset", "latency") else 0.0
            if not least <= value <= most:
                raise InvalidInput(f"{name} is {value:g}.", f"Need {least:g} to {most:g}.")
        if not set(self.unobserved) <= set(PARAMETERS):
            raise InvalidInput(f"unobserved is {self.unobserved}.", f"Name only {', '.join(PARAMETERS)}.")

    @property
    def stds(self) -> dict[str, float]:
        """The standard deviation of each of `PARAMETERS`."""
        return dict(zip(PARAMETERS, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))
