"""Proposer `random`: the candidate rectangles of the paper's Algorithm 1, in no particular order."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pretouch.errors import InvalidInput
from pretouch.geometry import Array
from pretouch.rectangle import ProposedRegion, RotatedRectangle
from pretouch.scene import Scene
from pretouch.tof import Sensor
from pretouch_detector.overlap import compute_common_areas

MIN_OVERLAP = 0.15
"""Least intersection over union with the object's bounding rectangle (Lancaster et al. 2017, Algorithm 1)."""
AREA = (0.10, 0.50)
"""Share of the bounding rectangle's area (likewise)."""
LOG_ASPECT = 1.2
"""The sides' ratio is log-uniform up to exp(1.2) = 3.3 either way; the paper does not specify it."""
_BATCH, _MAX_BATCHES = 512, 100
"""For objects up to 15 : 1 one rectangle in six is accepted, beyond 45 : 1 none."""


def propose(scene: Scene, sensor: Sensor, count: int, rng: np.random.Generator) -> list[ProposedRegion]:
    """`count` candidates; all have the same confidence."""
    return [ProposedRegion(rectangle, 0.5) for rectangle in draw_candidates(scene, count, rng)]


def draw_candidates(scene: Scene, count: int, rng: np.random.Generator) -> list[RotatedRectangle]:
    """As `draw_rectangles`, as rectangle objects."""
    return [RotatedRectangle(*row) for row in draw_rectangles(scene, count, rng)]


def draw_rectangles(scene: Scene, count: int, rng: np.random.Generator) -> Array:
    """(count, 5) as [x, y, w, h, theta]: centre uniform in the bounding rectangle, area and overlap as above.

    Few rectangles fit a very slim object, so that there may be fewer than `count`.

    Raises:
        InvalidInput: no rectangle was accepted.
    """
    low, high = _bound_object(scene)
    area = float(np.prod(high - low))
    found = np.zeros((0, 5))
    for _ in range(_MAX_BATCHES):
        centre = rng.uniform(low, high, (_BATCH, 2))
        size = rng.uniform(*AREA, _BATCH) * area
        width = np.sqrt(size * np.exp(rng.uniform(-LOG_ASPECT, LOG_ASPECT, _BATCH)))
        theta = rng.uniform(-np.pi / 2, np.pi / 2, _BATCH)
        batch = np.column_stack([centre, width, size / width, theta])
        found = np.concatenate([found, batch[_overlaps_enough(batch, low, high)]])
        if len(found) >= count:
            return found[:count]
    if not len(found):
        w, h = np.rint(high - low).astype(int)
        raise InvalidInput(
            f"The object takes {w} x {h} pixels: no rectangle overlaps so slim a strip well.",
            "Check the mask, or look at the object from another side.",
        )
    return found


def _bound_object(scene: Scene) -> tuple[Array, Array]:
    """Corners (u, v) of the object's bounding rectangle, pixels' edges included."""
    u0, v0, u1, v1 = scene.bounds()
    return np.array([u0, v0]) - 0.5, np.array([u1, v1]) - 0.5


def _overlaps_enough(rectangles: Array, low: Array, high: Array) -> NDArray[np.bool_]:
    bounding = np.concatenate([(low + high) / 2, high - low, [0.0]])
    common = compute_common_areas(bounding, rectangles)
    union = rectangles[:, 2] * rectangles[:, 3] + np.prod(high - low) - common
    return np.asarray(common / union >= MIN_OVERLAP, dtype=np.bool_)
