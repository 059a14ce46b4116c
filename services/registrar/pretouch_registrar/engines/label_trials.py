"""Registers many simulated scans of one depth image: the inner loops of the paper's Algorithm 1.

After Lancaster, Yang and Smith (IROS 2017). In each trial, of one rectangle and one offset, the target is the part of
the camera's cloud K that projects near the rectangle's perimeter. The source is the part of K', which is K moved by the
offset, that projects on the perimeter, with Gaussian noise. The score is the mean distance of the registered source
from its true place. The worst trial of a rectangle decides.

The noise is seeded by seed, rectangle and trial, so that scores do not depend on the number of threads, and so that the
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
from pretouch.geometry import Array, frozen_array, rotations_from_vectors
from pretouch.prior import Prior
from pretouch_registrar.engines import icp, pcl, point_to_plane, so3
from pretouch_registrar.engines.neighbours import Index, build_index
from pretouch_registrar.engines.perimeter import enclose_blocks, find_in_blocks, find_near_perimeter, sort_by_tile

_CHUNK = 8
"""Rectangles that a thread scores at a time."""
_PILOT = 16
"""Rectangles that are scored in all trials before any is pruned."""
_PLANE_NOISE = 0.0025
"""m: standard deviation of a distance along a normal in point-to-plane matching, of sensor and surface together."""


class Matching(IntEnum):
    """The registration method: an engine's kernel, or ICP without outlier rejection."""

    PLAIN = 0
    PAPER = 1
    PCL = 2
    POINT_TO_PLANE = 3


@dataclass(frozen=True)
class TrialSettings:
    """The settings of all trials.

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
        camera: the intrinsics.
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


def compute_scores(
    view: View,
    rectangles: ArrayLike,
    offsets: ArrayLike,
    trials: TrialSettings,
    threads: int | None = None,
    first: int = 0,
) -> Array:
    """(r, t), m: each rectangle's score in each trial.

    A scan with too few points to be registered is scored without registration; one without any point is scored by the
    whole object.

    Args:
        rectangles: (r, 5) as [x, y, w, h, theta], px and rad.
        offsets: (t, 6), rad and m: rotation vector about the object's centroid, then translation; camera axes.
        threads: how many; None: one for each processor.
        first: number of the first rectangle, when a list is scored in parts.

    Raises:
        Malformed, InvalidInput: wrong shapes or invalid numbers.
    """
    work = _Scorer(view, rectangles, offsets, trials, threads, first)
    return work.score(np.arange(len(work.boxes)), np.arange(len(work.moves)))


def find_best(
    view: View, rectangles: ArrayLike, offsets: ArrayLike, trials: TrialSettings, threads: int | None = None
) -> tuple[int, float]:
    """The rectangle with the lowest score in its worst trial, and that score, m: as by `compute_scores`, but quicker.

    A few rectangles are scored in all trials, which shows which trials are the hardest. The others are scored in the
    hardest one, and then, in the order of that score, in the next hardest and so on, until a score exceeds the worst
    score of another rectangle.
    """
    work = _Scorer(view, rectangles, offsets, trials, threads, 0)
    number = len(work.boxes)
    worst = np.full(number, np.inf)
    pilot = np.unique(np.linspace(0, number - 1, _PILOT).astype(np.int64))
    known = work.score(pilot, np.arange(len(work.moves)))
    worst[pilot] = known.max(axis=1)
    hardest = np.argsort(-known.mean(axis=0), kind="stable")
    bound = np.array([worst.min()])
    others = np.setdiff1d(np.arange(number), pilot)
    first = work.score(others, hardest[:1])[:, 0]
    hopeful = np.argsort(first, kind="stable")[: int((first <= bound[0]).sum())]
    rest = work.score(others[hopeful], hardest[1:], first[hopeful], bound)
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
        precision: (6, 6), the prior's.
    """

    turns: Array
    moves: Array
    centre: Array
    precision: Array


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


class _Scorer:
    """Scores rectangles of one view, with what all of its trials share."""

    def __init__(
        self,
        view: View,
        rectangles: ArrayLike,
        offsets: ArrayLike,
        trials: TrialSettings,
        threads: int | None,
        first: int,
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
        precision = np.asarray(np.linalg.inv(trials.prior.covariance), dtype=np.float64)
        tiles = sort_by_tile(seen)
        self._seen = _Seen(points, np.ascontiguousarray(normals, dtype=np.float64), seen)
        in_order = np.ascontiguousarray(moved_seen[:, tiles])
        self._moved = _Moved(moved, tiles, in_order, enclose_blocks(in_order))
        self._motions = _Motions(turns, self.moves, centre, precision)

    def score(
        self, rows: NDArray[np.int64], columns: NDArray[np.int64], so_far: Array | None = None,
        bound: Array | None = None,
    ) -> Array:  # fmt: skip
        """Scores (r, t), m, of the rectangles `rows` (r,) in the trials `columns` (t,).

        With `bound` (1,), m, rectangles are pruned: a rectangle's scores are inf from the trial on in which its worst
        score, `so_far` (r,) at first, exceeds the bound. The bound is lowered to the worst score of each other one.
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
    turns, moves, centre, precision = motions
    matching, noise, on, near, seed = settings
    r, t = np.eye(3), np.zeros(3)
    for b in range(boxes.shape[0]):
        if pruned and so_far[b] > bound[0]:
            result[b] = np.inf
            continue
        near_by = find_near_perimeter(seen.pixels, boxes[b], near)
        target = seen.points[near_by]
        if matching == 2:
            for i in range(target.shape[0]):
                for k in range(3):
                    target[i, k] = np.float32(target[i, k])
        matchable = target.shape[0] >= icp.MIN_CORRESPONDENCES
        index = build_index(target if matchable else centre.reshape(1, 3))
        surface = seen.normals[near_by][index.order] if matchable else seen.normals[:1]
        worst = so_far[b]
        for c in range(columns.shape[0]):
            j = columns[c]
            met = find_in_blocks(moved.pixels[j], moved.circles[j], moved.order, boxes[b], on)
            source = moved.points[j][met]
            np.random.seed((seed + numbers[b] * moves.shape[0] + j) % 4294967296)
            for i in range(source.shape[0]):
                for k in range(3):
                    source[i, k] += noise * np.random.standard_normal()
            r[:], t[:] = np.eye(3), np.zeros(3)
            if matchable and source.shape[0] >= icp.MIN_CORRESPONDENCES:
                _match(source, index, surface, centre, precision, matching, r, t)
            scored = source if source.shape[0] > 0 else moved.points[j]
            result[b, c] = _mean_error(scored, r, t, turns[j], centre, moves[j])
            worst = max(worst, result[b, c])
            if pruned and worst > bound[0]:
                result[b, c:] = np.inf
                break
        if pruned and worst < bound[0]:
            bound[0] = worst


@njit(cache=True, nogil=True)
def _match(
    source: Array, index: Index, surface: Array, centre: Array, precision: Array, matching: int, r: Array, t: Array
) -> None:
    """Fills r (3, 3), t (3,) with the motion of the source onto the target, by the kernel of `matching`."""
    if matching == 2:
        pcl.match(source, index, r, t)
    elif matching == 3:
        x, planes = np.zeros(6), point_to_plane.Planes(index, surface)
        point_to_plane.match(source, np.ones(source.shape[0]), planes, centre, precision, _PLANE_NOISE, x)
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
    """m: mean distance of the source (n, 3), registered by (r, t), from where the inverse of `move` (6,) puts it."""
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
