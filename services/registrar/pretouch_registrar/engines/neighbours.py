"""Exact nearest neighbours among a target's points, by a uniform grid that is built once per target.

Between the rounds of an ICP a point moves little. `find` lists for each point the few nearest targets of its last
search, and how far all others were: while the nearest one listed is nearer than that, less what the point has moved
since, no search is needed. A search visits only the cells that a ball through the last neighbour meets.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch.geometry import Array

MAX_TARGET = 200_000
"""Larger targets are thinned out to this many points, evenly in their given order, such as an image's rows."""
_POINTS_PER_CELL = 5.0
_CELLS_PER_POINT = 16
_SMALLEST_CELL = 1e-4
_SLACK = 0.4
"""Cells that a search looks further than the nearest point, so that later rounds can do without a search."""
_LISTED = 8
"""Nearest targets kept from a search."""


class Index(NamedTuple):
    """A target's points sorted into the cells of a grid.

    Attributes:
        points: (m, 3), m, in the order of the cells.
        order: (m,) where each of them was in the target.
        starts: (cells + 1,) first point of each cell; cells along the last axis follow each other.
        dims: (3,) cells per axis.
        low: (3,), m, the grid's corner.
        cell: m, a cell's side.
    """

    points: Array
    order: NDArray[np.int32]
    starts: NDArray[np.int32]
    dims: NDArray[np.int64]
    low: Array
    cell: float


class Pairs(NamedTuple):
    """What is known of n source points' neighbours.

    Attributes:
        neighbour: (n,) place in `Index.points`; -1 when there is none.
        distance: (n,) to it, m; inf without one.
        near: (n, _LISTED + 1) the targets nearest to the point at its last search, as places in `Index.points`.
        listed: (n,) how many of them count.
        others: (n,) m: at the last search no target that is not listed was nearer.
        searched: (n, 3), m, where the point was at its last search.
    """

    neighbour: NDArray[np.int32]
    distance: Array
    near: NDArray[np.int32]
    listed: NDArray[np.int32]
    others: Array
    searched: Array


def thinned(target: Array, most: int = MAX_TARGET) -> Array:
    """At most `most` of a target's points (m, 3), evenly in their order."""
    step = max(1, -(-len(target) // most))
    return np.ascontiguousarray(target[::step], dtype=np.float64)


@njit(cache=True, nogil=True)
def index_of(target: Array) -> Index:
    """The grid over `target` (m, 3), m, m >= 1, finite; takes time in proportion to m."""
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
    dims, starts, cell = _counted(target, low, high, cell, cells)
    occupied = 0
    for g in range(starts.shape[0] - 1):
        if starts[g + 1] > starts[g]:
            occupied += 1
    crowding = m / (_POINTS_PER_CELL * occupied)
    if crowding > 1.5:
        dims, starts, cell = _counted(target, low, high, max(cell / np.sqrt(crowding), _SMALLEST_CELL), cells)
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
def _counted(
    target: Array, low: Array, high: Array, cell: float, cells: NDArray[np.int32]
) -> tuple[NDArray[np.int64], NDArray[np.int32], float]:
    """Cells per axis, first point of each cell, and the cell's side, wider than asked where cells would be too many.

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
def no_pairs(n: int) -> Pairs:
    """Nothing known yet of n source points."""
    return Pairs(
        np.full(n, -1, np.int32),
        np.full(n, np.inf),
        np.empty((n, _LISTED + 1), np.int32),
        np.zeros(n, np.int32),
        np.full(n, -1.0),
        np.zeros((n, 3)),
    )


@njit(cache=True, nogil=True)
def find(source: Array, index: Index, reach: float, pairs: Pairs) -> None:
    """Brings `pairs` up to date for `source` (n, 3), m: each point's nearest target, if it is within `reach`, m."""
    points = index.points
    distances = np.empty(_LISTED + 1)
    before = -1
    for i in range(source.shape[0]):
        x, y, z = source[i, 0], source[i, 1], source[i, 2]
        best, nearest = -1, np.inf
        for k in range(pairs.listed[i]):
            j = pairs.near[i, k]
            d = (x - points[j, 0]) ** 2 + (y - points[j, 1]) ** 2 + (z - points[j, 2]) ** 2
            if d < nearest:
                best, nearest = j, d
        nearest = np.sqrt(nearest)
        searched = pairs.searched[i]
        moved = np.sqrt((x - searched[0]) ** 2 + (y - searched[1]) ** 2 + (z - searched[2]) ** 2)
        if min(nearest, reach) > pairs.others[i] - moved:
            if best < 0 and before >= 0:
                nearest = np.sqrt(
                    (x - points[before, 0]) ** 2 + (y - points[before, 1]) ** 2 + (z - points[before, 2]) ** 2
                )
            best, nearest = _search(x, y, z, index, min(nearest, reach), pairs, i, distances)
        before = best
        if nearest <= reach:
            pairs.neighbour[i], pairs.distance[i] = best, nearest
        else:
            pairs.neighbour[i], pairs.distance[i] = -1, np.inf


@njit(cache=True, nogil=True)
def _search(
    x: float, y: float, z: float, index: Index, farthest: float, pairs: Pairs, i: int, distances: Array
) -> tuple[int, float]:
    """The nearest target, if it is within `farthest`, m, else one further away or -1 and inf; lists it and others.

    Without a neighbour from an earlier search it looks in balls that grow, from a cell on, until one holds a target.
    """
    pairs.searched[i, 0], pairs.searched[i, 1], pairs.searched[i, 2] = x, y, z
    slack = _SLACK * index.cell
    near = pairs.near[i]
    radius = farthest if pairs.listed[i] > 0 else min(farthest, index.cell)
    while True:
        count, pairs.others[i] = _ball(x, y, z, index, radius + slack, slack, near, distances)
        pairs.listed[i] = count
        if count > 0:
            return near[0], np.sqrt(distances[0])
        if radius >= farthest:
            return -1, np.inf
        radius = min(farthest, 2.0 * radius)


@njit(cache=True, nogil=True)
def _ball(
    x: float, y: float, z: float, index: Index, radius: float, slack: float, near: NDArray[np.int32], distances: Array
) -> tuple[int, float]:
    """Fills `near` (k,) and `distances` (k,), m^2, with the nearest points within `radius`, in order.

    Of those, the ones no further than `slack` beyond the nearest. Returns their number, at most _LISTED, and a
    distance, m, that no point is nearer than that is not among them.
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
                if count < _LISTED:
                    count += 1
                else:
                    limit = min(limit, distances[_LISTED])
    while count > 0 and distances[count - 1] > limit:
        count -= 1
    return count, np.sqrt(limit)
