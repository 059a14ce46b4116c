"""Classifies the samples under a correction: inliers, and those that contradict it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch_registrar.engines import so3
from pretouch_registrar.engines.correction import carry_back, turn_back
from pretouch_registrar.engines.objective import assume_likeliest_hypothesis
from pretouch_registrar.engines.registration_problem import RegistrationProblem
from pretouch_registrar.engines.residuals.cone import make_spot, spot_residual, trace_spot
from pretouch_registrar.engines.residuals.miss import miss_cost
from pretouch_registrar.engines.residuals.point import NORMAL, PointResiduals, compute_half_square, point_residual
from pretouch_registrar.engines.robust_kernel import CAP_BEHIND, CAP_FRONT, robust_cost

_MAX_HALF_SQUARE = 4.5
"""Half the squared normalised residual of 3 sigma, up to which a sample is an inlier."""


class Classification(NamedTuple):
    """The n samples under a correction.

    Attributes:
        residuals: (n,), m, of a return along the surface's normal, or along the beam if that is wide; 0 for a miss.
        inlier: (n,), returns that are explained within 3 sigma.
        contradicting: (n,), samples that no surface hidden from the camera explains: returns in front of or below the
            seen surface, or far from the predicted range, and misses of beams that cross the seen surface.
    """

    residuals: Array
    inlier: NDArray[np.bool_]
    contradicting: NDArray[np.bool_]


def classify_samples(x: Array, problem: RegistrationProblem) -> Classification:
    """The problem's samples under the correction x (6,); those of a wide beam by its likeliest hypothesis there."""
    count = len(problem.beams.weights)
    result = Classification(np.zeros(count), np.zeros(count, dtype=np.bool_), np.zeros(count, dtype=np.bool_))
    if problem.wide:
        _classify_wide(x, assume_likeliest_hypothesis(x, problem), result)
    else:
        _classify_thin(x, problem, result)
    return result


@njit(cache=True, nogil=True, error_model="numpy")
def _classify_thin(x: Array, problem: RegistrationProblem, result: Classification) -> None:
    beams, target = problem.beams, problem.target
    r = so3.exp(x[:3])
    out = PointResiduals(np.zeros(3), np.zeros((3, 3)))
    most = robust_cost(_MAX_HALF_SQUARE, CAP_FRONT)
    for n in range(beams.weights.shape[0]):
        point = carry_back(x, r, target.centroid, beams.points, n)
        direction = turn_back(r, beams.directions, n)
        if not beams.returned[n]:
            result.contradicting[n] = miss_cost(point, direction, target, problem.noise) > most
            continue
        cap, beyond = point_residual(point, direction, target, problem.noise, out)
        slope = out.gradients[NORMAL]
        length = np.sqrt(slope[0] * slope[0] + slope[1] * slope[1] + slope[2] * slope[2])
        result.residuals[n] = out.values[NORMAL] / length
        result.inlier[n] = compute_half_square(out) < _MAX_HALF_SQUARE
        result.contradicting[n] = not result.inlier[n] and cap + beyond > CAP_BEHIND + 0.5 * (CAP_FRONT - CAP_BEHIND)


@njit(cache=True, nogil=True, error_model="numpy")
def _classify_wide(x: Array, problem: RegistrationProblem, result: Classification) -> None:
    beams, target = problem.beams, problem.target
    r = so3.exp(x[:3])
    spot = make_spot(problem.cone)
    for n in range(beams.weights.shape[0]):
        end = carry_back(x, r, target.centroid, beams.points, n)
        direction = turn_back(r, beams.directions, n)
        returned, measured = beams.returned[n], beams.ranges[n]
        interval = trace_spot(end, direction, returned, measured, target, problem.cone, spot)
        e, _, _ = spot_residual(0, returned, measured, interval, target.optics.range_max, problem.noise, spot)
        far = 0.5 * e * e >= _MAX_HALF_SQUARE
        result.contradicting[n] = far
        if returned:
            result.residuals[n] = measured - spot.means[0]
            result.inlier[n] = not far
