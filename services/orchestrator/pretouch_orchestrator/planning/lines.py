"""Straight lines across the object: short ways over two of its edges."""

from __future__ import annotations

import numpy as np

from pretouch.geometry import Array
from pretouch.scene import SCAN_MARGIN
from pretouch_orchestrator.perception.heightmap import HeightMap

_HEADINGS = 4
_LEVELS = (0.25, 0.75)
"""Where the lines of one heading lie: shares of the object's area to one side of them."""


def trace_lines(surface: HeightMap) -> list[Array]:
    """Lines as their ends (2, 2), m, in the table's frame, from one side of the object's seen part to the other.

    They begin and end SCAN_MARGIN beside it.
    """
    cells = np.argwhere(surface.object_distance <= 0)
    places = surface.origin + surface.cell * cells
    lines = []
    for heading in np.pi * np.arange(_HEADINGS) / _HEADINGS:
        along = np.array([np.cos(heading), np.sin(heading)])
        across = np.array([-along[1], along[0]])
        travelled, beside = places @ along, places @ across
        for level in np.quantile(beside, _LEVELS):
            crossed = travelled[np.abs(beside - level) <= surface.cell]
            if len(crossed):
                ends = np.array([crossed.min() - SCAN_MARGIN, crossed.max() + SCAN_MARGIN])
                lines.append(ends[:, None] * along + level * across)
    return lines
