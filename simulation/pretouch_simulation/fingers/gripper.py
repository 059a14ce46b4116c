"""`gripper`: a gripper's fingertip with six VL6180X modules, after the pretouch finger of Lancaster et al. 2017.

The layout is ours. The fingertip is 24 mm wide, along the tip's y, and its pad faces x, where the other finger is:

    module   at (x, y, z), mm   looks
    0, 1     (0, -+6, 0)        ahead, along z
    2, 3     (0, -+11, -3)      45 deg out to its own side
    4        (-6, 0, -3)        45 deg out to the back
    5        (6, 0, -12)        sideways from the pad, along x
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pretouch.geometry import Pose, rotation_from_vector
from pretouch_simulation.fingers.several import Several
from pretouch_simulation.fingers.vl6180x import SENSOR as MODULE
from pretouch_simulation.fingers.vl6180x import VL6180X

_QUARTER = np.pi / 4
_LAYOUT = (
    ((0.0, -0.006, 0.0), (0.0, 0.0, 0.0)),
    ((0.0, 0.006, 0.0), (0.0, 0.0, 0.0)),
    ((0.0, -0.011, -0.003), (_QUARTER, 0.0, 0.0)),
    ((0.0, 0.011, -0.003), (-_QUARTER, 0.0, 0.0)),
    ((-0.006, 0.0, -0.003), (0.0, -_QUARTER, 0.0)),
    ((0.006, 0.0, -0.012), (0.0, 2 * _QUARTER, 0.0)),
)
"""Place, m, and rotation vector, rad, of each module in the tip's frame."""

SENSOR = replace(MODULE, tip_T_module=tuple(Pose.of(rotation_from_vector(turn), place) for place, turn in _LAYOUT))


def draw(rng: np.random.Generator) -> Several:
    """The fingertip; nothing about it varies."""
    return Several(SENSOR, (VL6180X(),) * len(_LAYOUT))
