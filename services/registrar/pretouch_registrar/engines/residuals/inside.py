"""How far inside the object's footprint a beam entered it, through a surface that the camera saw."""

from __future__ import annotations

from numba import njit

from pretouch_registrar.engines.camera_model import Footprint
from pretouch_registrar.engines.correction import Vector
from pretouch_registrar.engines.projection import find_cell
from pretouch_registrar.engines.registration_problem import Table

BELOW = 0.006
"""m: a point this much below the seen surface is below it in spite of noise."""
FOOTPRINT_SLACK = 0.0015
"""m: the footprint's outline is known to about half a cell; smaller distances inside it cost nothing."""


@njit(cache=True, nogil=True, inline="always")
def depth_inside(footprint: Footprint, a: int, b: int, std: float) -> float:
    """Normalised distance of a cell from the footprint's outline."""
    return max(footprint.inside[a, b] - FOOTPRINT_SLACK, 0.0) / std


@njit(cache=True, nogil=True, inline="always")
def find_pierced_cell(
    point: Vector, direction: Vector, above: float, table: Table, footprint: Footprint
) -> tuple[int, int]:
    """The cell through which a beam that ends in `point`, `above` m over the table, entered; -1, -1 for none."""
    a, b = find_cell(point, footprint)
    if a < 0 or footprint.top[a, b] <= above + BELOW:
        return -1, -1
    normal = table.normal
    fall = -(normal[0] * direction[0] + normal[1] * direction[1] + normal[2] * direction[2])
    if fall < 0.5:
        return -1, -1
    back = (footprint.top[a, b] - above) / fall
    entry = (point[0] - back * direction[0], point[1] - back * direction[1], point[2] - back * direction[2])
    a, b = find_cell(entry, footprint)
    if a < 0 or footprint.top[a, b] <= above + BELOW:
        return -1, -1
    return a, b
