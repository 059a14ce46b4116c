"""Proposer `random`: the candidate rectangles of the paper's Algorithm 1, in no particular order."""

from __future__ import annotations

import numpy as np
import shapely

from pretouch.geometry import Array
from pretouch.rectangle import RotatedRectangle
from pretouch.scene import Scene
from pretouch.tof import Sensor
from pretouch_detector.proposals.region import ProposedRegion

MIN_OVERLAP = 0.15
"""Least intersection over union with the object's bounding rectangle (Lancaster et al. 2017, Algorithm 1)."""
AREA = (0.10, 0.50)
"""Share of the bounding rectangle's area (likewise)."""
_LOG_ASPECT = 1.2
"""Sides' ratios are log-uniform up to exp(1.2) = 3.3 either way; the paper does not say."""
_BATCH = 512


def propose(scene: Scene, sensor: Sensor, count: int, rng: np.random.Generator) -> list[ProposedRegion]:
    """`count` candidates; all have the same confidence."""
    return [ProposedRegion(rectangle, 0.5) for rectangle in candidates(scene, count, rng)]


def candidates(scene: Scene, count: int, rng: np.random.Generator) -> list[RotatedRectangle]:
    """Rectangles with a centre uniform in the object's bounding rectangle, area and overlap as above."""
    u0, v0, u1, v1 = scene.bounds()
    low, high = np.array([u0, v0]) - 0.5, np.array([u1, v1]) - 0.5
    area = float(np.prod(high - low))
    bounding = shapely.box(low[0], low[1], high[0], high[1])
    found: list[RotatedRectangle] = []
    while len(found) < count:
        centre = rng.uniform(low, high, (_BATCH, 2))
        size = rng.uniform(*AREA, _BATCH) * area
        width = np.sqrt(size * np.exp(rng.uniform(-_LOG_ASPECT, _LOG_ASPECT, _BATCH)))
        theta = rng.uniform(-np.pi / 2, np.pi / 2, _BATCH)
        drawn = np.column_stack([centre, width, size / width, theta])
        common = shapely.area(shapely.intersection(polygons(drawn), bounding))
        good = common / (area + size - common) >= MIN_OVERLAP
        found += [RotatedRectangle(*row) for row in drawn[good]]
    return found[:count]


def polygons(rectangles: Array) -> shapely.Geometry:
    """Shapely polygons (n,) of rectangles (n, 5) as [x, y, w, h, theta]."""
    x, y, w, h, theta = rectangles.T
    along = np.stack([np.cos(theta), np.sin(theta)], axis=1) * w[:, None] / 2
    across = np.stack([-np.sin(theta), np.cos(theta)], axis=1) * h[:, None] / 2
    centre = np.stack([x, y], axis=1)
    corners = [centre - along - across, centre + along - across, centre + along + across, centre - along + across]
    return shapely.polygons(np.stack(corners, axis=1))
