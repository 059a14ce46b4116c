"""Whether a thing looks round: the same from all sides about an axis of a given direction."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pretouch.geometry import Array, Plane

_SLICE = 0.008
"""m along the axis: points of one slice should be equally far from it."""
_SECTORS = 24
_ROUNDS, _REWEIGHTINGS = 4, 5
_TOLERANCE = 0.002
"""m, and the share of the radius: how far the outline of something round strays from a circle, depth noise included."""
_SHARE = 0.06
_MIN_SECTORS = 6
_ROUND_SHARE = 2 / 3
_CLOSE, _CLOSE_SHARE = 0.0015, 0.02
"""m, and the share of the radius: rms by which the outline of a slice that is round for certain strays."""
_CERTAIN_SHARE, _CERTAIN_SLICES, _CERTAIN_SECTORS = 0.5, 5, 16
"""Of the outline, how much must lie in such slices; and how many slices there must be, or sectors of one slice."""
_MOST_RADIUS = 0.12
"""m: a larger circle is a gentle curve."""


class Revolution(NamedTuple):
    """An axis about which a cloud looks round.

    Attributes:
        point: (3,), m, on it.
        certain: whether so exactly that nothing seen could tell how far it is turned.
    """

    point: Array
    certain: bool


def revolution_about(cloud: Array, direction: Array) -> Revolution | None:
    """The axis of a direction about which the cloud (n, 3), m, looks round; None if it does not.

    The outline of each slice across `direction` (3,), unit, is the farthest point of each of its sectors. One linear
    least squares fit gives the centre that all outlines share and a radius a slice (Kasa's circle fit), points that
    stray counting less; sectors are taken about the new centre, and so on. A camera sees one side of most slices only,
    which is enough; it also sees ghosts at edges, so that a third of the outline may lie in slices that are not round.
    """
    axes = Plane(direction, 0.0).frame().rotation
    local = cloud @ axes
    slices = np.floor((local[:, 2] - local[:, 2].min()) / _SLICE).astype(np.int64)
    centre = np.median(local[:, :2], axis=0)
    for _ in range(_ROUNDS):
        chosen = _outline(local[:, :2] - centre, slices)
        if chosen is None:
            return None
        outline, (_, ring) = local[chosen, :2], np.unique(slices[chosen], return_inverse=True)
        square = (outline**2).sum(axis=1)
        weight = np.ones(len(outline))
        for _ in range(_REWEIGHTINGS):
            mean = np.array([np.bincount(ring, weight * column) for column in (*outline.T, square)])
            mean /= np.bincount(ring, weight)
            root = np.sqrt(weight)
            apart = 2 * (outline - mean[:2, ring].T) * root[:, None]
            centre = np.linalg.lstsq(apart, (square - mean[2, ring]) * root, rcond=None)[0]
            radii = np.sqrt(np.maximum(mean[2] - 2 * centre @ mean[:2] + centre @ centre, 0.0))[ring]
            strays = np.abs(np.linalg.norm(outline - centre, axis=1) - radii)
            limit = _TOLERANCE + _SHARE * radii
            weight = 1.0 / (1.0 + (strays / limit) ** 2)
    worst = np.zeros(ring.max() + 1)
    np.maximum.at(worst, ring, strays / limit)
    if (worst[ring] <= 2.0).mean() < _ROUND_SHARE:
        return None
    point = np.asarray(axes @ [*centre, local[:, 2].mean()], dtype=np.float64)
    return Revolution(point, _certain(ring, strays, radii))


def _certain(ring: NDArray[np.intp], strays: Array, radii: Array) -> bool:
    """Of outline points (k,) in slices `ring`: how far off their circle, and its radius."""
    count = np.bincount(ring)
    rms, radius = np.sqrt(np.bincount(ring, strays**2) / count), np.bincount(ring, radii) / count
    close = (rms < _CLOSE + _CLOSE_SHARE * radius) & (radius < _MOST_RADIUS)
    enough = len(count) >= _CERTAIN_SLICES or count[close].max(initial=0) >= _CERTAIN_SECTORS
    return bool(enough and close[ring].mean() > _CERTAIN_SHARE)


def _outline(local: Array, slices: Array) -> Array | None:
    """Indices of the farthest point of each sector, in slices that are seen in enough sectors; None without any."""
    distance = np.hypot(local[:, 0], local[:, 1])
    sector = np.floor((np.arctan2(local[:, 1], local[:, 0]) / (2 * np.pi) + 0.5) * _SECTORS).astype(np.int64)
    cell = slices * (_SECTORS + 1) + sector
    order = np.lexsort((-distance, cell))
    _, first = np.unique(cell[order], return_index=True)
    farthest = order[first]
    seen = np.bincount(slices[farthest])[slices[farthest]] >= _MIN_SECTORS
    return np.asarray(farthest[seen]) if seen.any() else None
