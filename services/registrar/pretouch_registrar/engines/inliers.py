"""Which samples a correction explains, and which contradict it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pretouch.geometry import Array
from pretouch_registrar.engines import so3
from pretouch_registrar.engines.correction import carried_back, turned_back
from pretouch_registrar.engines.objective import supposing_likeliest
from pretouch_registrar.engines.problem import Problem
from pretouch_registrar.engines.residuals.cone import measure, spot_of, spot_residual
from pretouch_registrar.engines.residuals.miss import miss_cost
from pretouch_registrar.engines.residuals.point import NORMAL, PointResiduals, half_square, point_residual
from pretouch_registrar.engines.robust_kernel import CAP_BEHIND, CAP_FRONT, robust_cost

_HALF_GATE = 4.5
"""Half the squared normalised residual, 3 sigma, up to which a sample agrees."""


class Judged(NamedTuple):
    """What becomes of each beam (n,) under a correction.

    Attributes:
        residuals: m, of a return, along the surface's normal or, of a wide beam, along the beam; 0 for a miss.
        agree: returns that are explained within 3 sigma.
        contradict: samples that cannot be where they are, whatever is hidden from the camera: returns in front of or
            below what it saw, or far from the range that they should have, and beams that missed what it saw.
    """

    residuals: Array
    agree: NDArray[np.bool_]
    contradict: NDArray[np.bool_]


def judged(x: Array, problem: Problem) -> Judged:
    """The samples of the problem under the correction x (6,), of a wide beam by its likeliest hypothesis there."""
    count = len(problem.beams.weights)
    answer = Judged(np.zeros(count), np.zeros(count, dtype=np.bool_), np.zeros(count, dtype=np.bool_))
    if problem.wide:
        _judge_wide(x, supposing_likeliest(x, problem), answer)
    else:
        _judge_thin(x, problem, answer)
    return answer


@njit(cache=True, nogil=True, error_model="numpy")
def _judge_thin(x: Array, problem: Problem, answer: Judged) -> None:
    beams, target = problem.beams, problem.target
    r = so3.exp(x[:3])
    out = PointResiduals(np.zeros(3), np.zeros((3, 3)))
    most = robust_cost(_HALF_GATE, CAP_FRONT)
    for n in range(beams.weights.shape[0]):
        point = carried_back(x, r, target.centroid, beams.points, n)
        direction = turned_back(r, beams.directions, n)
        if not beams.returned[n]:
            answer.contradict[n] = miss_cost(point, direction, target, problem.noise) > most
            continue
        cap, beyond = point_residual(point, direction, target, problem.noise, out)
        slope = out.gradients[NORMAL]
        length = np.sqrt(slope[0] * slope[0] + slope[1] * slope[1] + slope[2] * slope[2])
        answer.residuals[n] = out.values[NORMAL] / length
        answer.agree[n] = half_square(out) < _HALF_GATE
        answer.contradict[n] = not answer.agree[n] and cap + beyond > CAP_BEHIND + 0.5 * (CAP_FRONT - CAP_BEHIND)


@njit(cache=True, nogil=True, error_model="numpy")
def _judge_wide(x: Array, problem: Problem, answer: Judged) -> None:
    beams, target = problem.beams, problem.target
    r = so3.exp(x[:3])
    spot = spot_of(problem.cone)
    for n in range(beams.weights.shape[0]):
        end = carried_back(x, r, target.centroid, beams.points, n)
        direction = turned_back(r, beams.directions, n)
        returned, measured = beams.returned[n], beams.ranges[n]
        interval = measure(end, direction, returned, measured, target, problem.cone, spot)
        e, _, _ = spot_residual(0, returned, measured, interval, target.optics.range_max, problem.noise, spot)
        far = 0.5 * e * e >= _HALF_GATE
        answer.contradict[n] = far
        if returned:
            answer.residuals[n] = measured - spot.means[0]
            answer.agree[n] = not far
