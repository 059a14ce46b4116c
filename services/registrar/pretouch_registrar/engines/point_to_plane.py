"""Engine `point_to_plane`: the most probable correction of surface points under the calibration prior.

By damped point-to-plane ICP.

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

from typing import NamedTuple

import numpy as np
from numba import njit

from pretouch.geometry import Array
from pretouch_registrar.engines import so3
from pretouch_registrar.engines.camera_model import CameraModel
from pretouch_registrar.engines.correction import carried_back
from pretouch_registrar.engines.neighbours import Index, Pairs, find, index_of, no_pairs, thinned
from pretouch_registrar.engines.problem import Problem
from pretouch_registrar.engines.resources import Resources
from pretouch_registrar.engines.returns import object_returns
from pretouch_registrar.engines.robust_kernel import robust_weight
from pretouch_registrar.engines.solution import Solution

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


class Planes(NamedTuple):
    """A target whose points know their normals: the index of m points, and normals (m, 3) in its order."""

    target: Index
    normals: Array


class _Matched(NamedTuple):
    """Points (n, 3), m, what each is worth (n,), where the camera would have put them (n, 3), and their neighbours."""

    points: Array
    weights: Array
    carried: Array
    pairs: Pairs


def solve(problem: Problem, model: CameraModel, resources: Resources) -> Solution:
    """The most probable correction and its covariance."""
    source = problem.beams.points[object_returns(problem)]
    x = np.zeros(6)
    shares = shared(source, _PATCH)
    planes, centroid = resources.of_model(model, _planes), problem.target.centroid
    information = match(source, shares, planes, centroid, problem.prior, problem.noise.surface, x)
    covariance = np.linalg.inv(information / _OVERCONFIDENCE + np.diag(problem.prior))
    return Solution(x, np.asarray(covariance, dtype=np.float64))


def planes_of(points: Array, normals: Array) -> Planes:
    """What `match` takes as the target, of points (m, 3), m, and their normals (m, 3)."""
    index = index_of(thinned(points))
    return Planes(index, np.ascontiguousarray(thinned(normals)[index.order]))


def _planes(model: CameraModel) -> Planes:
    mask, surface = model.scene.mask, model.pixels.surface
    return planes_of(surface.points[mask].astype(np.float64), surface.normals[mask].astype(np.float64))


def shared(source: Array, patch: float) -> Array:
    """Weights (n,) of points (n, 3), m: all that share a cube of side `patch`, m, are worth one together."""
    cells = np.floor(source / patch).astype(np.int64)
    key = (cells[:, 0] * 1_000_003 + cells[:, 1]) * 1_000_003 + cells[:, 2]
    _, place, count = np.unique(key, return_inverse=True, return_counts=True)
    return np.asarray(1.0 / count[place], dtype=np.float64)


@njit(cache=True, nogil=True)
def match(source: Array, shares: Array, planes: Planes, centroid: Array, prior: Array, noise: float, x: Array) -> Array:
    """Moves the correction x (6,), about `centroid`, to the most probable one; returns what the points tell (6, 6).

    Args:
        source: (n, 3), m.
        shares: (n,) what each point is worth in the information that is returned, the prior's apart.
        planes: the target.
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
        matched = _Matched(some, weights, np.empty(some.shape), no_pairs(some.shape[0]))
        for _ in range(_ROUNDS):
            r = so3.exp(x[:3])
            _pair(r, x, centroid, matched, planes)
            _equations(r, x, centroid, matched, planes, noise * factor, information, gradient)
            for k in range(6):
                information[k, k] += prior[k]
                gradient[k] += prior[k] * x[k]
            step: Array = np.linalg.solve(information, -gradient).astype(np.float64)
            x[:3] = so3.log(so3.exp(step[:3]) @ r)
            x[3:] += step[3:]
            if np.abs(step[3:]).max() + radius * np.abs(step[:3]).max() < _STILL * factor:
                break
    r = so3.exp(x[:3])
    last = _Matched(source, shares, matched.carried, matched.pairs)
    _pair(r, x, centroid, last, planes)
    _equations(r, x, centroid, last, planes, noise, information, gradient)
    return information


@njit(cache=True, nogil=True)
def _pair(r: Array, x: Array, centroid: Array, matched: _Matched, planes: Planes) -> None:
    """Carries the points back by x (6,), with r = exp(w) (3, 3), and finds their neighbours."""
    carried = matched.carried
    for i in range(carried.shape[0]):
        carried[i, 0], carried[i, 1], carried[i, 2] = carried_back(x, r, centroid, matched.points, i)
    find(carried, planes.target, MAX_DISTANCE, matched.pairs)


@njit(cache=True, nogil=True)
def _equations(
    r: Array, x: Array, centroid: Array, matched: _Matched, planes: Planes, noise: float,
    information: Array, gradient: Array,
) -> None:  # fmt: skip
    """Fills the information (6, 6) and gradient (6,) of a Gauss-Newton step, robust weights frozen, without a prior."""
    source, carried, points, normals = matched.points, matched.carried, planes.target.points, planes.normals
    information[:] = 0.0
    gradient[:] = 0.0
    row = np.empty(6)
    for i in range(source.shape[0]):
        j = matched.pairs.neighbour[i]
        if j < 0:
            continue
        n0, n1, n2 = normals[j, 0], normals[j, 1], normals[j, 2]
        e0, e1, e2 = carried[i, 0] - points[j, 0], carried[i, 1] - points[j, 1], carried[i, 2] - points[j, 2]
        residual = (n0 * e0 + n1 * e1 + n2 * e2) / noise
        half = 0.5 * (matched.pairs.distance[i] / noise) ** 2
        weight = matched.weights[i] * robust_weight(half, _CAP)
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
