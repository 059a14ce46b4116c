"""The rays of a module's field of view: where they point, and how strongly the module responds along each."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from pretouch.geometry import Array, rotation_from_vector

_RINGS = 4
_GAUSSIAN_REACH = 1.6
_FLAT_REACH = 1.15


class Profile(StrEnum):
    """How the response falls off the axis; to half at the half angle, either way."""

    GAUSSIAN = "gaussian"
    FLAT = "flat"


@dataclass(frozen=True)
class Spot:
    """A field of view.

    Attributes:
        half_angle: rad, where the response is half of that on the axis; 0 is a single ray.
        boresight: (x, y), rad: the turns about the module's x and y that take its z to the true axis.
    """

    half_angle: float
    profile: Profile = Profile.GAUSSIAN
    boresight: tuple[float, float] = (0.0, 0.0)

    def rays(self) -> tuple[Array, Array]:
        """Unit rays (k, 3) in the module's frame, an equal share of the view each, and the response (k,) along each.

        61 rays: one on the axis and rings of 6, 12, 18, 24. A Gaussian is cut at 1.6 half angles, where it is 0.17.
        """
        turned = rotation_from_vector([*self.boresight, 0.0])
        if self.half_angle == 0:
            return turned[:, 2][None], np.ones(1)
        reach = _GAUSSIAN_REACH if self.profile is Profile.GAUSSIAN else _FLAT_REACH
        polar, turn = [np.zeros(1)], [np.zeros(1)]
        for ring in range(1, _RINGS + 1):
            count = 6 * ring
            polar.append(np.full(count, reach * self.half_angle * ring / (_RINGS + 0.5)))
            turn.append(2 * np.pi * (np.arange(count) + 0.5 * (ring % 2)) / count)
        t, p = np.concatenate(polar), np.concatenate(turn)
        rays = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=1)
        power = 2 if self.profile is Profile.GAUSSIAN else 10
        return rays @ turned.T, np.exp(-np.log(2.0) * (t / self.half_angle) ** power)
