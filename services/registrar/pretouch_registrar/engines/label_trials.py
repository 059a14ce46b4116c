"""Many scans of one depth image, matched at once: the inner loops of the paper's Algorithm 1.

After Lancaster, Yang and Smith (IROS 2017). For each rectangle and each offset: the target is cut out of the camera's
cloud K where it projects near the rectangle's perimeter; the source out of the cloud K' that the offset has moved,
where it projects on the perimeter, with Gaussian noise; the score is the mean distance of the matched source from its
true match. A rectangle is as good as its worst trial.

The noise is fixed by seed, rectangle and trial, so that scores do not depend on the number of threads, and one call's
rectangles may be split over several calls by `first`.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from pretouch.camera import Camera
from pretouch.errors import InvalidInput
from pretouch.estimate import Prior
from pretouch.geometry import Array, frozen_array, rotations_from_vectors
from pretouch_registrar.engines import icp, pcl, point_to_plane, so3
from pretouch_registrar.engines.neighbours import Index, index_of
from pretouch_registrar.engines.perimeter import among_blocks, around_perimeter, blocks, in_tiles

_CHUNK = 8
"""Rectangles that a thread takes at a time."""
_PILOT = 16
"""Rectangles that are scored whole before any is given up."""
_PLANE_NOISE = 0.0025
"""m: of a distance along a normal, when matching is point to plane: the sensor's and the surface's."""


class Matching(IntEnum):
    """How source and target are matched: by which engine's kernel, or by ICP without any rejection."""

    PLAIN = 0
    PAPER = 1
    PCL = 2
    POINT_TO_PLANE = 3


@dataclass(frozen=True)
class Trials:
    """What happens in each trial.

    Attributes:
        matching: point to plane needs the image's normals.
        noise: m, standard deviation of the source's noise, each axis.
        on, near: px, how far from the perimeter the source's and the target's points may project.
        prior: of the offset, when matching is point to plane.
        seed: of the noise.
    """

    matching: Matching = Matching.PCL
    noise: float = 0.0015
    on: float = 0.75
    near: float = 6.0
    prior: Prior = field(default_factory=Prior)
    seed: int = 0


@dataclass(frozen=True, eq=False)
class View:
    """One organised cloud, in the camera's frame.

    Attributes:
        cloud: (h, w, 3), m.
        mask: (h, w) bool, the object's points.
        camera: which projects them.
        normals: (h, w, 3), unit; only point to plane needs them.

    Raises:
        InvalidInput: no object point, or shapes that differ.
    """

    cloud: Array
    mask: NDArray[np.bool_]
    camera: Camera
    normals: Array | None = None

    def __post_init__(self) -> None:
        shape = self.mask.shape
        same = self.cloud.shape == (*shape, 3) and (self.normals is None or self.normals.shape == (*shape, 3))
        if len(shape) != 2 or not same or not self.mask.any():
            raise InvalidInput(
                f"The cloud is {list(self.cloud.shape)}, the mask {list(shape)} with {int(self.mask.sum())} points.",
                "Give (h, w, 3) points and normals, and an (h, w) mask with at least one point.",
            )


def scores(
    view: View, rectangles: ArrayLike, offsets: ArrayLike, trials: Trials, threads: int | None = None, first: int = 0
) -> Array:
    """(r, t), m: each rectangle's score in each trial.

    A scan that cannot be matched, having too few points, scores what it would without a match; one without any point,
    what the whole object would.

    Args:
        rectangles: (r, 5) as [x, y, w, h, theta], px and rad.
        offsets: (t, 6), rad and m: rotation vector about the object's centroid, then translation; camera axes.
        threads: how many; None: one for each processor.
        first: number of the first rectangle, when a list is scored in parts.

    Raises:
        Malformed, InvalidInput: shapes or numbers that make no sense.
    """
    work = _Work(view, rectangles, offsets, trials, threads, first)
    return work.scored(np.arange(len(work.boxes)), np.arange(len(work.moves)))


def best(
    view: View, rectangles: ArrayLike, offsets: ArrayLike, trials: Trials, threads: int | None = None
) -> tuple[int, float]:
    """The rectangle whose worst trial scores least, and that score, m: the same as by `scores`, in less time.

    A few rectangles are scored whole; they tell which trials are the hard ones. The others are scored in the hardest,
    and, the least first, in the next hardest and so on until a trial scores worse than the worst of another rectangle.
    """
    work = _Work(view, rectangles, offsets, trials, threads, 0)
    number = len(work.boxes)
    worst = np.full(number, np.inf)
    pilot = np.unique(np.linspace(0, number - 1, _PILOT).astype(np.int64))
    known = work.scored(pilot, np.arange(len(work.moves)))
    worst[pilot] = known.max(axis=1)
    hardest = np.argsort(-known.mean(axis=0), kind="stable")
    bound = np.array([worst.min()])
    others = np.setdiff1d(np.arange(number), pilot)
    first = work.scored(others, hardest[:1])[:, 0]
    hopeful = np.argsort(first, kind="stable")[: int((first <= bound[0]).sum())]
    rest = work.scored(others[hopeful], hardest[1:], first[hopeful], bound)
    worst[others[hopeful]] = np.maximum(first[hopeful], rest.max(axis=1, initial=0.0))
    winner = int(np.argmin(worst))
    return winner, float(worst[winner])


class _Seen(NamedTuple):
    """The object as the camera sees it: points (n, 3), m, their normals (n, 3), and their pixels (n, 2)."""

    points: Array
    normals: Array
    pixels: NDArray[np.float32]


class _Moved(NamedTuple):
    """The object as each offset puts it.

    Attributes:
        points: (t, n, 3), m.
        order: (n,), of the pixels, in tiles.
        pixels: (t, n, 2), in that order.
        circles: (t, b, 3), around blocks of them.
    """

    points: Array
    order: NDArray[np.int64]
    pixels: NDArray[np.float32]
    circles: Array


class _Motions(NamedTuple):
    """The offsets.

    Attributes:
        turns: (t, 3, 3).
        moves: (t, 6), rad and m.
        centre: (3,), m, which the turns leave in place.
        prior: (6,), their precision.
    """

    turns: Array
    moves: Array
    centre: Array
    prior: Array


class _Settings(NamedTuple):
    """What kernels need of `Trials`."""

    matching: int
    noise: float
    on: float
    near: float
    seed: int


class _Part(NamedTuple):
    """What is scored in one go.

    Attributes:
        boxes: (r, 5), px and rad.
        numbers: (r,), of the boxes among all.
        columns: (c,), the trials.
        so_far: (r,), m, the worst score of each box before.
        pruned: whether a box is given up once it scores worse than the bound.
    """

    boxes: Array
    numbers: NDArray[np.int64]
    columns: NDArray[np.int64]
    so_far: Array
    pruned: bool


class _Work:
    """What all rectangles and trials of one view have in common."""

    def __init__(
        self, view: View, rectangles: ArrayLike, offsets: ArrayLike, trials: Trials, threads: int | None, first: int
    ) -> None:
        self.boxes = np.ascontiguousarray(frozen_array(rectangles, (None, 5), "rectangles"))
        self.moves = np.ascontiguousarray(frozen_array(offsets, (None, 6), "offsets"))
        if not len(self.boxes) or not len(self.moves):
            raise InvalidInput("There is no rectangle or no offset.", "Give at least one of each.")
        if trials.matching is Matching.POINT_TO_PLANE and view.normals is None:
            raise InvalidInput(
                "Matching point to plane needs the view's normals.", "Give View.normals, or choose another matching."
            )
        self._threads, self._first = threads or os.cpu_count() or 1, first
        self._settings = _Settings(int(trials.matching), trials.noise, trials.on, trials.near, trials.seed)
        points = np.ascontiguousarray(view.cloud[view.mask], dtype=np.float64)
        normals = view.normals[view.mask] if view.normals is not None else np.zeros_like(points)
        centre = points.mean(axis=0)
        turns = np.ascontiguousarray(rotations_from_vectors(self.moves[:, :3]))
        moved = np.einsum("tij,nj->tni", turns, points - centre) + centre + self.moves[:, None, 3:]
        seen = view.camera.project(points).astype(np.float32)
        moved_seen = view.camera.project(moved).astype(np.float32)
        prior = np.array([trials.prior.rotation_std**-2.0] * 3 + [trials.prior.translation_std**-2.0] * 3)
        tiles = in_tiles(seen)
        self._seen = _Seen(points, np.ascontiguousarray(normals, dtype=np.float64), seen)
        in_order = np.ascontiguousarray(moved_seen[:, tiles])
        self._moved = _Moved(moved, tiles, in_order, blocks(in_order))
        self._motions = _Motions(turns, self.moves, centre, prior)

    def scored(
        self, rows: NDArray[np.int64], columns: NDArray[np.int64], so_far: Array | None = None,
        bound: Array | None = None,
    ) -> Array:  # fmt: skip
        """Scores (r, t), m, of the rectangles `rows` (r,) in the trials `columns` (t,).

        With `bound` (1,), m: inf from the trial on in which a rectangle, at `so_far` (r,) to begin with, exceeds it; it
        is lowered to the worst of each that does not.
        """
        result = np.empty((len(rows), len(columns)))
        before = np.zeros(len(rows)) if so_far is None else so_far
        limit = np.array([np.inf]) if bound is None else bound

        def score(start: int) -> None:
            chunk = slice(start, start + _CHUNK)
            boxes, numbers = self.boxes[rows[chunk]], self._first + rows[chunk]
            part = _Part(boxes, numbers, columns, before[chunk], bound is not None)
            _score(part, self._seen, self._moved, self._motions, self._settings, limit, result[chunk])

        with ThreadPoolExecutor(self._threads) as pool:
            list(pool.map(score, range(0, len(rows), _CHUNK)))
        return result


@njit(cache=True, nogil=True)
def _score(
    part: _Part, seen: _Seen, moved: _Moved, motions: _Motions, settings: _Settings, bound: Array, result: Array
) -> None:
    """Fills `result` (r, c), m, and lowers `bound` (1,), m, to the worst score of each box that stays below it."""
    boxes, numbers, columns, so_far, pruned = part
    turns, moves, centre, prior = motions
    matching, noise, on, near, seed = settings
    r, t = np.eye(3), np.zeros(3)
    for b in range(boxes.shape[0]):
        if pruned and so_far[b] > bound[0]:
            result[b] = np.inf
            continue
        near_by = around_perimeter(seen.pixels, boxes[b], near)
        target = seen.points[near_by]
        if matching == 2:
            for i in range(target.shape[0]):
                for k in range(3):
                    target[i, k] = np.float32(target[i, k])
        matchable = target.shape[0] >= icp.MIN_PAIRS
        index = index_of(target if matchable else centre.reshape(1, 3))
        surface = seen.normals[near_by][index.order] if matchable else seen.normals[:1]
        worst = so_far[b]
        for c in range(columns.shape[0]):
            j = columns[c]
            met = among_blocks(moved.pixels[j], moved.circles[j], moved.order, boxes[b], on)
            source = moved.points[j][met]
            np.random.seed((seed + numbers[b] * moves.shape[0] + j) % 4294967296)
            for i in range(source.shape[0]):
                for k in range(3):
                    source[i, k] += noise * np.random.standard_normal()
            r[:], t[:] = np.eye(3), np.zeros(3)
            if matchable and source.shape[0] >= icp.MIN_PAIRS:
                _match(source, index, surface, centre, prior, matching, r, t)
            judged = source if source.shape[0] > 0 else moved.points[j]
            result[b, c] = _mean_error(judged, r, t, turns[j], centre, moves[j])
            worst = max(worst, result[b, c])
            if pruned and worst > bound[0]:
                result[b, c:] = np.inf
                break
        if pruned and worst < bound[0]:
            bound[0] = worst


@njit(cache=True, nogil=True)
def _match(
    source: Array, index: Index, surface: Array, centre: Array, prior: Array, matching: int, r: Array, t: Array
) -> None:
    """Fills r (3, 3), t (3,) with the motion of the source onto the target by one of the kernels."""
    if matching == 2:
        pcl.match(source, index, r, t)
    elif matching == 3:
        x, planes = np.zeros(6), point_to_plane.Planes(index, surface)
        point_to_plane.match(source, np.ones(source.shape[0]), planes, centre, prior, _PLANE_NOISE, x)
        turn = so3.exp(x[:3])
        for j in range(3):
            for k in range(3):
                r[j, k] = turn[k, j]
        for j in range(3):
            t[j] = centre[j]
            for k in range(3):
                t[j] -= r[j, k] * (centre[k] + x[3 + k])
    elif icp.align(source, index, matching == 1, r, t) == 0:
        r[:], t[:] = np.eye(3), np.zeros(3)


@njit(cache=True, nogil=True)
def _mean_error(source: Array, r: Array, t: Array, turn: Array, centre: Array, move: Array) -> float:
    """m: mean distance of the source (n, 3), matched by (r, t), from where `move` (6,), undone, puts it."""
    total = 0.0
    for i in range(source.shape[0]):
        y0 = source[i, 0] - centre[0] - move[3]
        y1 = source[i, 1] - centre[1] - move[4]
        y2 = source[i, 2] - centre[2] - move[5]
        apart = 0.0
        for k in range(3):
            matched = r[k, 0] * source[i, 0] + r[k, 1] * source[i, 1] + r[k, 2] * source[i, 2] + t[k]
            apart += (matched - turn[0, k] * y0 - turn[1, k] * y1 - turn[2, k] * y2 - centre[k]) ** 2
        total += np.sqrt(apart)
    return total / source.shape[0]
