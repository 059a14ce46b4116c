"""The zones of multizone sensors as modules with their own directions.

The directions follow from the field of view that a data sheet states: equal angles for all zones of a row or column.
They are in the sensor's own frame: z along the optical axis, x to the right and y down in the picture that is printed
row by row.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from pretouch.errors import InvalidInput
from pretouch.geometry import Pose
from pretouch_sensor_gateway.wire_formats.text import Modules

_MIRRORED = "-mirrored"


@dataclass(frozen=True)
class ZoneLayout:
    """The zones of one sensor.

    Attributes:
        side: zones in a row, and in a column.
        field_of_view: angles that a row and a column span, deg.
        along_axis: whether the sensor reports distances along its axis, not along each zone's beam.
    """

    side: int
    field_of_view: tuple[float, float]
    along_axis: bool

    def poses(self, mirrored: bool = False) -> tuple[Pose, ...]:
        """The pose of each zone in the sensor's frame, z along its beam, row by row; `mirrored`: from right to left."""
        across, down = (
            np.radians((np.arange(self.side) - (self.side - 1) / 2) * angle / self.side) for angle in self.field_of_view
        )
        if mirrored:
            across = across[::-1]
        return tuple(_pose(math.tan(x), math.tan(y)) for y in down for x in across)

    def modules(self) -> Modules:
        """How many zones there are, and the range along each beam for a reading of 1."""
        cosines = [pose.rotation[2, 2] for pose in self.poses()] if self.along_axis else []
        return Modules(self.side**2, tuple(float(1 / cosine) for cosine in cosines))


_SENSORS = {"vl53l5cx": (45.0, True), "vl53l7cx": (60.0, True), "vl53l8cx": (45.0, True)}
"""Angle across the square field of view, deg, and whether distances are along the axis. ST data sheets DS13754
(VL53L5CX, 63 deg diagonal), DS14161 (VL53L8CX, 65 deg diagonal) and that of the VL53L7CX (90 deg diagonal)."""
LAYOUTS: Mapping[str, ZoneLayout] = MappingProxyType(
    {
        f"{name}-{side}x{side}": ZoneLayout(side, (angle, angle), along_axis)
        for name, (angle, along_axis) in _SENSORS.items()
        for side in (4, 8)
    }
    | {"tmf8820-3x3": ZoneLayout(3, (33.0, 32.0), along_axis=False)}  # ams OSRAM data sheet DS000693
)


def find_zones(name: str, printed_mirrored: bool) -> tuple[tuple[Pose, ...], Modules]:
    """The poses of a sensor's zones in its frame, and what is known of them as modules.

    Args:
        name: one of `LAYOUTS`, with "-mirrored" if what it prints is the other way round than expected.
        printed_mirrored: whether the wire format prints each row from right to left.

    Raises:
        InvalidInput: there is no such sensor.
    """
    layout = LAYOUTS.get(name.removesuffix(_MIRRORED))
    if layout is None:
        raise InvalidInput(f"There are no zones {name!r}.", f"Choose one of {', '.join(LAYOUTS)}.")
    return layout.poses(name.endswith(_MIRRORED) != printed_mirrored), layout.modules()


def _pose(x: float, y: float) -> Pose:
    """The pose at the origin whose z points to (x, y, 1), turned on the shortest way."""
    direction = np.array([x, y, 1.0]) / math.hypot(x, y, 1.0)
    axis = np.array([-direction[1], direction[0], 0.0])
    sine = float(np.hypot(direction[0], direction[1]))
    angle = math.atan2(sine, float(direction[2]))
    return Pose.from_rotation_vector(axis / sine * angle if sine else axis, np.zeros(3))
