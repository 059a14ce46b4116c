"""Finds out whether a cloud is rotationally symmetric about an axis of a given direction."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pretouch.geometry import Array, Plane

_SLICE = 0.008
"""m along the axis: the thickness of a slice, whose points should be equally far from the axis."""
_SECTORS = 24
_ROUNDS, _REWEIGHTINGS = 4, 5
_TOLERANCE = 0.002
"""m, and the share of the radius: how far the outline of a round object deviates from a circle, with depth noise."""
_SHARE = 0.06
_MIN_SECTORS = 6
_ROUND_SHARE = 2 / 3
_CLOSE, _CLOSE_SHARE = 0.0015, 0.02
"""m, and the share of the radius: largest rms deviation of the outline of a slice that is certainly round."""
_CERTAIN_SHARE, _CERTAIN_SLICES, _CERTAIN_SECTORS = 0.5, 5, 16
"""Share of the outline that must lie in such slices, and how many slices, or sectors of one slice, there must be."""
_MAX_RADIUS = 0.12
"""m: a larger circle is taken to be a slightly curved surface."""


class SymmetryAxis(NamedTuple):
    """An axis about which a cloud is rotationally symmetric.

    Attributes:
        point: (3,), m, on it.
        certain: whether so exactly that the rotation about it cannot be observed.
    """

    point: Array
    certain: bool


def find_symmetry_axis(cloud: Array, direction: Array) -> SymmetryAxis | None:
    """The axis along `direction` (3,), unit, about which the cloud (n, 3), m, is symmetric; None if there is none.

    The cloud is cut into slices across the axis, and the outline of a slice is the farthest point of each of its
    sectors. A robust linear least squares fit (Kasa's circle fit) gives the centre that all outlines share and a radius
    for each slice; then the sectors are taken about the new centre, and so on. It is enough to see one side of most
    slices. Since depth images have artefacts at edges, a third of the outline may lie in slices that are not round.
    """
    axes = Plane(direction, 0.0).frame().rotation
    local = cloud @ axes
    slices = np.floor((local[:, 2] - local[:, 2].min()) / _SLICE).astype(np.int64)
    centre = np.median(local[:, :2], axis=0)
    for _ in range(_ROUNDS):
        chosen = _find_outline(local[:, :2] - centre, slices)
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
    return SymmetryAxis(point, _is_certain(ring, strays, radii))


def _is_certain(ring: NDArray[np.intp], strays: Array, radii: Array) -> bool:
    """Whether the symmetry is certain.

    Args:
        ring: (k,), the slice of each point of the outline.
        strays: (k,), m: its distance from the slice's circle.
        radii: (k,), m: that circle's radius.
    """
    count = np.bincount(ring)
    rms, radius = np.sqrt(np.bincount(ring, strays**2) / count), np.bincount(ring, radii) / count
    close = (rms < _CLOSE + _CLOSE_SHARE * radius) & (radius < _MAX_RADIUS)
    enough = len(count) >= _CERTAIN_SLICES or count[close].max(initial=0) >= _CERTAIN_SECTORS
    return bool(enough and close[ring].mean() > _CERTAIN_SHARE)


def _find_outline(local: Array, slices: Array) -> Array | None:
    """Indices of the farthest point of each sector, in slices that are seen in enough sectors; None without any."""
    distance = np.hypot(local[:, 0], local[:, 1])
    sector = np.floor((np.arctan2(local[:, 1], local[:, 0]) / (2 * np.pi) + 0.5) * _SECTORS).astype(np.int64)
    cell = slices * (_SECTORS + 1) + sector
    order = np.lexsort((-distance, cell))
    _, first = np.unique(cell[order], return_index=True)
    farthest = order[first]
    seen = np.bincount(slices[farthest])[slices[farthest]] >= _MIN_SECTORS
    return np.asarray(farthest[seen]) if seen.any() else None
