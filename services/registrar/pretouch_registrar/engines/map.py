"""Engine `map`: damped point-to-plane ICP, the most probable correction of surface points under the calibration prior.

Each return above the table is matched with the nearest point of the camera's smoothed surface; its distance along that
point's normal counts, the less the further apart the two are (Geman-McClure weights). Gauss-Newton steps with the
Gaussian prior on the correction, which keeps the match from sliding along planes; the noise at first widened, then as
it is. Misses, silhouettes and the table tell it nothing: engine `posterior` uses those.

Neighbouring returns share the camera model's error: for the covariance, the inverse of the information matrix, all
returns in one cube of a few millimetres count as one, and so do equal points. A wide beam has a wider cube and more
noise. Too few returns, returns on one line or nowhere near the object leave the prior's covariance in what they do not
tell. A cloud of more than `neighbours.MAX_TARGET` points is thinned out.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch_registrar.engines.camera_model import PLANE, POINT, CameraModel
from pretouch_registrar.engines.neighbours import Index, find, index_of, no_pairs, thinned
from pretouch_registrar.engines.problem import EDGE_STD, Problem
from pretouch_registrar.engines.returns import OncePerModel, object_returns
from pretouch_registrar.engines.solution import Solution
from pretouch_registrar.engines.turns import rotation_of, vector_of

MAX_DISTANCE = 0.03
"""m: pairs further apart are not considered."""
_ANNEALING = np.array([4.0, 2.0, 1.0])
"""Factors by which the noise is widened in turn."""
_ROUNDS = 15
"""Steps at each factor, at most."""
_FEWEST = 25
"""Steps at a noise widened k times take every k-th return, but no fewer than this."""
_STILL = 1e-4
"""m: a step that moves the object by less ends the steps at a factor."""
_CAP = 1.0
"""Half a pair's squared distance over the noise's at which the pair counts a quarter."""
WORTH = 60.0
"""Returns that a problem is worth at most, against the prior."""
_PATCH = 0.009
"""m: the camera model's error is the same over this length."""
_OVERCONFIDENCE = 5.0
"""The information is divided by this; chosen for coverage on training meshes."""


def solve(problem: Problem) -> Solution:
    """The most probable correction and its covariance."""
    index, normals = _surface(problem.model)
    source = problem.beams[object_returns(problem), :3]
    x = np.zeros(6)
    spot = 2.0 * np.sqrt(max(0.0, problem.noise[2] ** 2 - EDGE_STD**2))
    shares = shared(source, _PATCH + 2.0 * spot)
    information = match(source, shares, index, normals, problem.centroid, problem.prior, float(problem.noise[0]), x)
    covariance = np.linalg.inv(information / _OVERCONFIDENCE + np.diag(problem.prior))
    return Solution(x, np.asarray(covariance, dtype=np.float64))


def surface_of(points: Array, normals: Array) -> tuple[Index, Array]:
    """What `match` takes as the target: the index of points (m, 3), and their normals (m, 3) in its order."""
    index = index_of(thinned(points))
    return index, np.ascontiguousarray(thinned(normals)[index.order])


def _of_model(model: CameraModel) -> tuple[Index, Array]:
    pixels = model.pixels[model.scene.mask].astype(np.float64)
    return surface_of(pixels[:, POINT : POINT + 3], pixels[:, PLANE : PLANE + 3])


_surface: OncePerModel[tuple[Index, Array]] = OncePerModel(_of_model)


def shared(source: Array, patch: float) -> Array:
    """Weights (n,) of points (n, 3), m: all that share a cube of side `patch`, m, are worth one together."""
    cells = np.floor(source / patch).astype(np.int64)
    key = (cells[:, 0] * 1_000_003 + cells[:, 1]) * 1_000_003 + cells[:, 2]
    _, place, count = np.unique(key, return_inverse=True, return_counts=True)
    return np.asarray(1.0 / count[place], dtype=np.float64)


@njit(cache=True, nogil=True)
def match(
    source: Array, shares: Array, index: Index, normals: Array, centroid: Array, prior: Array, noise: float, x: Array
) -> Array:
    """Moves the correction x (6,), about `centroid`, to the most probable one; returns what the points tell (6, 6).

    Args:
        source: (n, 3), m.
        shares: (n,) what each point is worth in the information that is returned, the prior's apart.
        normals: (m, 3) of the target's points, in the order of `index`.
        prior: (6,) inverse variances of the correction.
        noise: m, standard deviation of one distance.
    """
    information, gradient = np.empty((6, 6)), np.empty(6)
    radius = 0.0
    for i in range(source.shape[0]):
        radius = max(radius, np.sqrt(((source[i] - centroid) ** 2).sum()))
    for factor in _ANNEALING:
        step_over = max(1, min(int(factor), source.shape[0] // _FEWEST))
        some = source[::step_over].copy()
        weights = np.full(some.shape[0], min(1.0, WORTH / max(source.shape[0], 1)) * step_over)
        pairs, carried = no_pairs(some.shape[0]), np.empty(some.shape)
        for _ in range(_ROUNDS):
            r = rotation_of(x[:3])
            _carry_back(r, x, some, centroid, carried)
            find(carried, index, MAX_DISTANCE, pairs)
            _equations(
                r, x, some, weights, carried, index.points, normals, pairs.neighbour, pairs.distance, centroid,
                noise * factor, information, gradient,
            )  # fmt: skip
            for k in range(6):
                information[k, k] += prior[k]
                gradient[k] += prior[k] * x[k]
            step: Array = np.linalg.solve(information, -gradient).astype(np.float64)
            x[:3] = vector_of(rotation_of(step[:3]) @ r)
            x[3:] += step[3:]
            if np.abs(step[3:]).max() + radius * np.abs(step[:3]).max() < _STILL * factor:
                break
    r = rotation_of(x[:3])
    _carry_back(r, x, source, centroid, carried)
    find(carried, index, MAX_DISTANCE, pairs)
    _equations(
        r, x, source, shares, carried, index.points, normals, pairs.neighbour, pairs.distance, centroid, noise,
        information, gradient,
    )  # fmt: skip
    return information


@njit(cache=True, nogil=True)
def _carry_back(r: Array, x: Array, source: Array, centroid: Array, carried: Array) -> None:
    """Fills `carried` (n, 3): where the camera would have put the source's points."""
    for i in range(source.shape[0]):
        y0 = source[i, 0] - centroid[0] - x[3]
        y1 = source[i, 1] - centroid[1] - x[4]
        y2 = source[i, 2] - centroid[2] - x[5]
        for k in range(3):
            carried[i, k] = r[0, k] * y0 + r[1, k] * y1 + r[2, k] * y2 + centroid[k]


@njit(cache=True, nogil=True)
def _equations(
    r: Array, x: Array, source: Array, weights: Array, carried: Array, points: Array, normals: Array,
    neighbour: NDArray[np.int32], distance: Array, centroid: Array, noise: float, information: Array, gradient: Array,
) -> None:  # fmt: skip
    """Fills the information (6, 6) and gradient (6,) of a Gauss-Newton step, robust weights frozen, without a prior."""
    information[:] = 0.0
    gradient[:] = 0.0
    row = np.empty(6)
    for i in range(source.shape[0]):
        j = neighbour[i]
        if j < 0:
            continue
        n0, n1, n2 = normals[j, 0], normals[j, 1], normals[j, 2]
        e0, e1, e2 = carried[i, 0] - points[j, 0], carried[i, 1] - points[j, 1], carried[i, 2] - points[j, 2]
        residual = (n0 * e0 + n1 * e1 + n2 * e2) / noise
        half = 0.5 * (distance[i] / noise) ** 2
        weight = weights[i] * (_CAP / (_CAP + half)) ** 2
        g0 = (r[0, 0] * n0 + r[0, 1] * n1 + r[0, 2] * n2) / noise
        g1 = (r[1, 0] * n0 + r[1, 1] * n1 + r[1, 2] * n2) / noise
        g2 = (r[2, 0] * n0 + r[2, 1] * n1 + r[2, 2] * n2) / noise
        y0 = source[i, 0] - centroid[0] - x[3]
        y1 = source[i, 1] - centroid[1] - x[4]
        y2 = source[i, 2] - centroid[2] - x[5]
        row[0], row[1], row[2] = g1 * y2 - g2 * y1, g2 * y0 - g0 * y2, g0 * y1 - g1 * y0
        row[3], row[4], row[5] = -g0, -g1, -g2
        for k in range(6):
            gradient[k] += weight * row[k] * residual
            for m in range(k + 1):
                information[k, m] += weight * row[k] * row[m]
    for k in range(6):
        for m in range(k + 1, 6):
            information[k, m] = information[m, k]
