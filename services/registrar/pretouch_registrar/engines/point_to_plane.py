"""Engine `point_to_plane`: the maximum a posteriori correction by point-to-plane ICP with the calibration prior.

The correspondence of each return above the table is the nearest point of the camera's smoothed surface. The residual is
the distance along that point's normal, with a Geman-McClure weight by the distance of the two points. Gauss-Newton
steps include the Gaussian prior on the correction, which keeps the source from sliding along planes; the noise is
annealed from four times its value. Misses, silhouettes and the table are not used; engine `posterior` uses them.

Neighbouring returns share the camera model's error. For the covariance, the inverse of the information matrix, all
returns in a cube of a few millimetres therefore count as one. Where returns are too few, on one line or far from the
object, the covariance stays the prior's in the directions that they do not constrain. A cloud of more than
`neighbours.MAX_TARGET` points is subsampled.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from pretouch.geometry import Array
from pretouch_registrar.engines import so3
from pretouch_registrar.engines.camera_model import CameraModel
from pretouch_registrar.engines.correction import carry_back
from pretouch_registrar.engines.neighbours import (
    Correspondences,
    Index,
    build_index,
    find_neighbours,
    make_correspondences,
    subsample,
)
from pretouch_registrar.engines.point_matching import select_object_returns
from pretouch_registrar.engines.registration_problem import RegistrationProblem
from pretouch_registrar.engines.resources import Resources
from pretouch_registrar.engines.robust_kernel import robust_weight
from pretouch_registrar.engines.solution import Solution

MAX_DISTANCE = 0.03
"""m: correspondences further apart are not considered."""
_ANNEALING = np.array([4.0, 2.0, 1.0])
"""Factors on the noise, in this order."""
_ROUNDS = 15
"""Maximum number of steps at each factor."""
_MIN_RETURNS = 25
"""Steps at noise factor k use every k-th return, but at least this many."""
_MIN_STEP = 1e-4
"""m: a step that moves the object by less is the last one at its factor."""
_CAP = 1.0
"""Half the squared normalised distance at which a correspondence has a quarter of its weight."""
MAX_EFFECTIVE_RETURNS = 60.0
"""Upper bound of the effective number of returns, relative to the prior."""
_PATCH = 0.009
"""m: length over which the camera model's error is constant."""
_OVERCONFIDENCE = 5.0
"""The information is divided by this; chosen for coverage on training meshes."""


class Planes(NamedTuple):
    """A target with normals: the index of m points, and normals (m, 3) in its order."""

    target: Index
    normals: Array


class _Source(NamedTuple):
    """Source points (n, 3), m, their weights (n,), the points as carried back (n, 3), and their correspondences."""

    points: Array
    weights: Array
    carried: Array
    correspondences: Correspondences


def solve(problem: RegistrationProblem, model: CameraModel, resources: Resources) -> Solution:
    """The most probable correction and its covariance."""
    source = problem.beams.points[select_object_returns(problem)]
    x = np.zeros(6)
    shares = compute_shared_weights(source, _PATCH)
    planes, centroid = resources.derive_from_model(model, _make_model_planes), problem.target.centroid
    information = match(source, shares, planes, centroid, problem.prior.precision, problem.noise.surface, x)
    covariance = np.linalg.inv(information / _OVERCONFIDENCE + problem.prior.precision)
    return Solution(x, np.asarray(covariance, dtype=np.float64))


def make_planes(points: Array, normals: Array) -> Planes:
    """The target for `match`, of points (m, 3), m, with their normals (m, 3)."""
    index = build_index(subsample(points))
    return Planes(index, np.ascontiguousarray(subsample(normals)[index.order]))


def _make_model_planes(model: CameraModel) -> Planes:
    mask, surface = model.scene.mask, model.pixels.surface
    return make_planes(surface.points[mask].astype(np.float64), surface.normals[mask].astype(np.float64))


def compute_shared_weights(source: Array, patch: float) -> Array:
    """Weights (n,) of points (n, 3), m: those in one cube of side `patch`, m, have weights that sum to 1."""
    cells = np.floor(source / patch).astype(np.int64)
    key = (cells[:, 0] * 1_000_003 + cells[:, 1]) * 1_000_003 + cells[:, 2]
    _, place, count = np.unique(key, return_inverse=True, return_counts=True)
    return np.asarray(1.0 / count[place], dtype=np.float64)


@njit(cache=True, nogil=True)
def match(
    source: Array, shares: Array, planes: Planes, centroid: Array, precision: Array, noise: float, x: Array
) -> Array:
    """Moves the correction x (6,), about `centroid`, to the most probable one; returns the points' information (6, 6).

    Args:
        source: (n, 3), m.
        shares: (n,), the weight of each point in the information returned, which excludes the prior's.
        planes: the target.
        precision: (6, 6), the prior's.
        noise: m, standard deviation of one distance.
    """
    information, gradient = np.empty((6, 6)), np.empty(6)
    radius = 0.0
    for i in range(source.shape[0]):
        radius = max(radius, np.sqrt(((source[i] - centroid) ** 2).sum()))
    for factor in _ANNEALING:
        step_over = max(1, min(int(factor), source.shape[0] // _MIN_RETURNS))
        some = source[::step_over].copy()
        weights = np.full(some.shape[0], min(1.0, MAX_EFFECTIVE_RETURNS / max(source.shape[0], 1)) * step_over)
        matched = _Source(some, weights, np.empty(some.shape), make_correspondences(some.shape[0]))
        for _ in range(_ROUNDS):
            r = so3.exp(x[:3])
            _find_correspondences(r, x, centroid, matched, planes)
            _linearize(r, x, centroid, matched, planes, noise * factor, information, gradient)
            information += precision
            gradient += precision @ x
            step: Array = np.linalg.solve(information, -gradient).astype(np.float64)
            x[:3] = so3.log(so3.exp(step[:3]) @ r)
            x[3:] += step[3:]
            if np.abs(step[3:]).max() + radius * np.abs(step[:3]).max() < _MIN_STEP * factor:
                break
    r = so3.exp(x[:3])
    last = _Source(source, shares, matched.carried, matched.correspondences)
    _find_correspondences(r, x, centroid, last, planes)
    _linearize(r, x, centroid, last, planes, noise, information, gradient)
    return information


@njit(cache=True, nogil=True)
def _find_correspondences(r: Array, x: Array, centroid: Array, matched: _Source, planes: Planes) -> None:
    """Carries the points back by x (6,), with r = exp(w) (3, 3), and finds their correspondences."""
    carried = matched.carried
    for i in range(carried.shape[0]):
        carried[i, 0], carried[i, 1], carried[i, 2] = carry_back(x, r, centroid, matched.points, i)
    find_neighbours(carried, planes.target, MAX_DISTANCE, matched.correspondences)


@njit(cache=True, nogil=True)
def _linearize(
    r: Array, x: Array, centroid: Array, matched: _Source, planes: Planes, noise: float,
    information: Array, gradient: Array,
) -> None:  # fmt: skip
    """Fills the information (6, 6) and gradient (6,) of a Gauss-Newton step with fixed weights, without the prior."""
    source, carried, points, normals = matched.points, matched.carried, planes.target.points, planes.normals
    information[:] = 0.0
    gradient[:] = 0.0
    row = np.empty(6)
    for i in range(source.shape[0]):
        j = matched.correspondences.neighbour[i]
        if j < 0:
            continue
        n0, n1, n2 = normals[j, 0], normals[j, 1], normals[j, 2]
        e0, e1, e2 = carried[i, 0] - points[j, 0], carried[i, 1] - points[j, 1], carried[i, 2] - points[j, 2]
        residual = (n0 * e0 + n1 * e1 + n2 * e2) / noise
        half = 0.5 * (matched.correspondences.distance[i] / noise) ** 2
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
