"""Exact nearest neighbours among a target's points, by a uniform grid that is built once per target.

Between the rounds of an ICP a point moves little. Therefore `find_neighbours` keeps, for each source point, the few
nearest target points of its last search, and a lower bound on the distance of all others. As long as the nearest one
kept is nearer than that bound, less what the point has moved since, no search is needed. A search visits only the cells
that a ball through the last neighbour meets.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch.geometry import Array

MAX_TARGET = 200_000
"""Larger targets are subsampled to this many points, evenly in their given order, such as an image's rows."""
_POINTS_PER_CELL = 5.0
_CELLS_PER_POINT = 16
_SMALLEST_CELL = 1e-4
_SLACK = 0.4
"""Cells by which a search goes beyond the nearest point, so that later rounds need no search."""
_LIST_LENGTH = 8
"""Nearest target points that a search keeps."""


class Index(NamedTuple):
    """A target's points sorted into the cells of a grid.

    Attributes:
        points: (m, 3), m, in the order of the cells.
        order: (m,), the index of each of them in the target.
        starts: (cells + 1,), first point of each cell; the last axis varies fastest.
        dims: (3,), cells per axis.
        low: (3,), m, the grid's corner.
        cell: m, a cell's side.
    """

    points: Array
    order: NDArray[np.int32]
    starts: NDArray[np.int32]
    dims: NDArray[np.int64]
    low: Array
    cell: float


class Correspondences(NamedTuple):
    """The nearest neighbours of n source points, and what their last searches found.

    Attributes:
        neighbour: (n,), index into `Index.points`; -1 if there is none.
        distance: (n,), m, to the neighbour; inf without one.
        near: (n, _LIST_LENGTH + 1), the target points nearest to each point at its last search, as such indices.
        listed: (n,), how many of them are valid.
        others: (n,), m: at the last search no other target point was nearer than this.
        searched: (n, 3), m, the point's position at its last search.
    """

    neighbour: NDArray[np.int32]
    distance: Array
    near: NDArray[np.int32]
    listed: NDArray[np.int32]
    others: Array
    searched: Array


def subsample(target: Array, most: int = MAX_TARGET) -> Array:
    """At most `most` of the points (m, 3), evenly in their order."""
    step = max(1, -(-len(target) // most))
    return np.ascontiguousarray(target[::step], dtype=np.float64)


@njit(cache=True, nogil=True)
def build_index(target: Array) -> Index:
    """The grid over `target` (m, 3), m, m >= 1, finite; its time is proportional to m."""
    m = target.shape[0]
    low, high = target[0].copy(), target[0].copy()
    for i in range(m):
        for k in range(3):
            low[k] = min(low[k], target[i, k])
            high[k] = max(high[k], target[i, k])
    sides = np.sort(high - low)
    area = sides[2] * max(sides[1], 0.05 * sides[2])
    cell = max(np.sqrt(_POINTS_PER_CELL * area / m), _SMALLEST_CELL)
    cells = np.empty(m, np.int32)
    dims, starts, cell = _assign_cells(target, low, high, cell, cells)
    occupied = 0
    for g in range(starts.shape[0] - 1):
        if starts[g + 1] > starts[g]:
            occupied += 1
    crowding = m / (_POINTS_PER_CELL * occupied)
    if crowding > 1.5:
        dims, starts, cell = _assign_cells(target, low, high, max(cell / np.sqrt(crowding), _SMALLEST_CELL), cells)
    place = starts[:-1].copy()
    points, order = np.empty((m, 3)), np.empty(m, np.int32)
    for i in range(m):
        at = place[cells[i]]
        place[cells[i]] += 1
        for k in range(3):
            points[at, k] = target[i, k]
        order[at] = i
    return Index(points, order, starts, dims, low, cell)


@njit(cache=True, nogil=True)
def _assign_cells(
    target: Array, low: Array, high: Array, cell: float, cells: NDArray[np.int32]
) -> tuple[NDArray[np.int64], NDArray[np.int32], float]:
    """Cells per axis, first point of each cell, and a cell's side, enlarged where there would be too many cells.

    Fills `cells` (m,) with each point's cell.
    """
    m = target.shape[0]
    dims = np.empty(3, np.int64)
    while True:
        total = 1.0
        for k in range(3):
            total *= np.floor((high[k] - low[k]) / cell) + 1.0
        if total <= _CELLS_PER_POINT * m + 64:
            break
        cell *= 1.3
    for k in range(3):
        dims[k] = int((high[k] - low[k]) / cell) + 1
    starts = np.zeros(dims[0] * dims[1] * dims[2] + 1, np.int32)
    for i in range(m):
        a = int((target[i, 0] - low[0]) / cell)
        b = int((target[i, 1] - low[1]) / cell)
        c = int((target[i, 2] - low[2]) / cell)
        cells[i] = (a * dims[1] + b) * dims[2] + c
        starts[cells[i] + 1] += 1
    for g in range(1, starts.shape[0]):
        starts[g] += starts[g - 1]
    return dims, starts, cell


@njit(cache=True, nogil=True)
def make_correspondences(n: int) -> Correspondences:
    """The correspondences of n source points before the first search."""
    return Correspondences(
        np.full(n, -1, np.int32),
        np.full(n, np.inf),
        np.empty((n, _LIST_LENGTH + 1), np.int32),
        np.zeros(n, np.int32),
        np.full(n, -1.0),
        np.zeros((n, 3)),
    )


@njit(cache=True, nogil=True)
def find_neighbours(source: Array, index: Index, reach: float, correspondences: Correspondences) -> None:
    """Updates `correspondences` for `source` (n, 3), m: each point's nearest target point, if within `reach`, m."""
    points = index.points
    distances = np.empty(_LIST_LENGTH + 1)
    before = -1
    for i in range(source.shape[0]):
        x, y, z = source[i, 0], source[i, 1], source[i, 2]
        best, nearest = -1, np.inf
        for k in range(correspondences.listed[i]):
            j = correspondences.near[i, k]
            d = (x - points[j, 0]) ** 2 + (y - points[j, 1]) ** 2 + (z - points[j, 2]) ** 2
            if d < nearest:
                best, nearest = j, d
        nearest = np.sqrt(nearest)
        searched = correspondences.searched[i]
        moved = np.sqrt((x - searched[0]) ** 2 + (y - searched[1]) ** 2 + (z - searched[2]) ** 2)
        if min(nearest, reach) > correspondences.others[i] - moved:
            if best < 0 and before >= 0:
                nearest = np.sqrt(
                    (x - points[before, 0]) ** 2 + (y - points[before, 1]) ** 2 + (z - points[before, 2]) ** 2
                )
            best, nearest = _search(x, y, z, index, min(nearest, reach), correspondences, i, distances)
        before = best
        if nearest <= reach:
            correspondences.neighbour[i], correspondences.distance[i] = best, nearest
        else:
            correspondences.neighbour[i], correspondences.distance[i] = -1, np.inf


@njit(cache=True, nogil=True)
def _search(
    x: float,
    y: float,
    z: float,
    index: Index,
    farthest: float,
    correspondences: Correspondences,
    i: int,
    distances: Array,
) -> tuple[int, float]:
    """The nearest target point and its distance, m, if within `farthest`, m; otherwise one farther away, or -1 and inf.

    It keeps the nearest ones in `correspondences`. Without a neighbour from an earlier search, it searches balls that
    grow from the size of a cell until one holds a target point.
    """
    correspondences.searched[i, 0], correspondences.searched[i, 1], correspondences.searched[i, 2] = x, y, z
    slack = _SLACK * index.cell
    near = correspondences.near[i]
    radius = farthest if correspondences.listed[i] > 0 else min(farthest, index.cell)
    while True:
        count, correspondences.others[i] = _search_ball(x, y, z, index, radius + slack, slack, near, distances)
        correspondences.listed[i] = count
        if count > 0:
            return near[0], np.sqrt(distances[0])
        if radius >= farthest:
            return -1, np.inf
        radius = min(farthest, 2.0 * radius)


@njit(cache=True, nogil=True)
def _search_ball(
    x: float, y: float, z: float, index: Index, radius: float, slack: float, near: NDArray[np.int32], distances: Array
) -> tuple[int, float]:
    """Fills `near` (k,) and `distances` (k,), m^2, with the nearest points within `radius`, in order.

    Only those no further than `slack` beyond the nearest are kept. Returns their number, at most _LIST_LENGTH, and a
    lower bound, m, on the distance of all other points.
    """
    points, starts, cell, dims = index.points, index.starts, index.cell, index.dims
    u, v, w = x - index.low[0], y - index.low[1], z - index.low[2]
    a0, a1 = max(int(np.floor((u - radius) / cell)), 0), min(int(np.floor((u + radius) / cell)), dims[0] - 1)
    b0, b1 = max(int(np.floor((v - radius) / cell)), 0), min(int(np.floor((v + radius) / cell)), dims[1] - 1)
    limit = radius * radius
    count = 0
    for a in range(a0, a1 + 1):
        da = max(a * cell - u, u - (a + 1) * cell, 0.0)
        for b in range(b0, b1 + 1):
            db = max(b * cell - v, v - (b + 1) * cell, 0.0)
            rest = limit - da * da - db * db
            if rest < 0:
                continue
            half = np.sqrt(rest)
            c0, c1 = max(int(np.floor((w - half) / cell)), 0), min(int(np.floor((w + half) / cell)), dims[2] - 1)
            if c1 < c0:
                continue
            row = (a * dims[1] + b) * dims[2]
            for j in range(starts[row + c0], starts[row + c1 + 1]):
                d = (x - points[j, 0]) ** 2 + (y - points[j, 1]) ** 2 + (z - points[j, 2]) ** 2
                if d >= limit:
                    continue
                k = count
                while k > 0 and distances[k - 1] > d:
                    distances[k] = distances[k - 1]
                    near[k] = near[k - 1]
                    k -= 1
                distances[k] = d
                near[k] = j
                if k == 0:
                    wide = np.sqrt(d) + slack
                    limit = min(limit, wide * wide)
                if count < _LIST_LENGTH:
                    count += 1
                else:
                    limit = min(limit, distances[_LIST_LENGTH])
    while count > 0 and distances[count - 1] > limit:
        count -= 1
    return count, np.sqrt(limit)
