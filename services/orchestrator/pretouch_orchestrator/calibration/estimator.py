"""From a camera's sessions to its calibration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pretouch.geometry import Array, Pose
from pretouch_orchestrator.calibration import assumptions
from pretouch_orchestrator.calibration.calibration import Calibration, Drift, DriftState
from pretouch_orchestrator.calibration.model import Sides, cross_matrix
from pretouch_orchestrator.calibration.observation import Measurement, Observation, difference, remove_prior
from pretouch_orchestrator.calibration.regimes import Course, Reading, Regime, filter_regimes, mean_residual, mix
from pretouch_orchestrator.calibration.residual import estimate_residual
from pretouch_orchestrator.calibration.widening import widen

_PASSES = 3
_SETTLED = 1e-2
"""rad or m: a change of the sides by less leaves no error of linearisation worth another pass."""
_RECENT = 8
"""Sessions after a knock until the camera counts as steady again."""
_SUSPECTED = 0.3
"""Probability from which it is told that a session disagrees."""
_WRONG = 0.5


def estimate_calibration(observations: Sequence[Observation]) -> Calibration:
    """What the sessions say together: a pure function, the same for any order of the sequence.

    Sessions are taken in the order of `at` (then of `session_id`), the latest `assumptions.MAX_OBSERVATIONS` of them.
    """
    latest = sorted(observations, key=lambda seen: (seen.at, seen.session_id))[-assumptions.MAX_OBSERVATIONS :]
    told = [(seen, remove_prior(seen)) for seen in latest]
    rejected = {seen.session_id: "It told nothing beyond its prior." for seen, own in told if not len(own.values)}
    told = [(seen, own) for seen, own in told if len(own.values)]
    if not told:
        return Calibration(rejected=rejected)
    sides = _start([seen for seen, _ in told])
    for _ in range(_PASSES):
        readings = [_read(sides, seen, own) for seen, own in told]
        course = filter_regimes(readings, sides.change_to_nothing(), _prior_covariance())
        regimes = course.regimes
        mean, covariance = _mix(regimes)
        sides = sides.changed(mean)
        if np.abs(mean).max() < _SETTLED:
            break
    seen = [seen for seen, _ in told]
    main = regimes[0]
    moves = sides.about_origins()
    return Calibration(
        camera_T_camera=sides.camera_T_camera,
        base_T_base=sides.base_T_base,
        covariance=moves @ covariance @ moves.T,
        residual=_residual(readings, mean, covariance, regimes, sides.camera_pivot),
        drift=_judge(seen, course),
        rejected=rejected | _explain(seen, main, sides),
        widening=widen([one for one in course.surprises[main.start + 1 :] if one is not None]),
        count=sum(right >= _WRONG for right in main.right),
        base_T_fixed=main.pose if len(main.right) >= assumptions.FIXED_SESSIONS else None,
    )


def _start(seen: list[Observation]) -> Sides:
    """No errors, their rotations about the middle of the objects."""
    in_camera = np.mean([one.base_T_camera.inverse().apply(one.centroid) for one in seen], axis=0)
    in_base = np.mean([one.centroid for one in seen], axis=0)
    return Sides(Pose.identity(), Pose.identity(), in_camera, in_base)


def _prior_covariance() -> Array:
    covariance = np.zeros((12, 12))
    covariance[:6, :6] = covariance[6:, 6:] = assumptions.SIDE.covariance
    return covariance


def _read(sides: Sides, seen: Observation, own: Measurement) -> Reading:
    expected = sides.correction(seen.base_T_camera)
    off = difference(seen.base_T_correction, expected, seen.centroid)
    return Reading(
        base_T_camera=seen.base_T_camera,
        jacobian=own.rows @ sides.jacobian(seen.base_T_camera, seen.centroid),
        values=own.rows @ off + own.values,
        variances=own.variances,
        rows=own.rows,
        camera_rows=own.rows[:, :3] - own.rows[:, 3:] @ cross_matrix(seen.centroid - seen.base_T_camera.translation),
    )


def _mix(regimes: list[Regime]) -> tuple[Array, Array]:
    weights = np.array([[regime.probability] for regime in regimes])
    means, covariances = (np.stack([getattr(one, name) for one in regimes]) for name in ("mean", "covariance"))
    mean, covariance = mix(weights, means[:, None], covariances[:, None])
    return mean[0], covariance[0]


def _residual(readings: list[Reading], mean: Array, covariance: Array, regimes: list[Regime], arm: Array) -> Array:
    """See `estimate_residual`; `arm` (3,): from the camera to the objects, in its axes."""
    main = regimes[0]
    counted = [
        reading._replace(values=reading.values - reading.jacobian @ mean)
        for reading, right in zip(readings[main.start :], main.right, strict=True)
        if right >= _WRONG
    ]
    about_camera = np.vstack([np.eye(3), -cross_matrix(arm)])
    return estimate_residual(counted, covariance, mean_residual(regimes).covariance(np.eye(6), about_camera))


def _judge(seen: list[Observation], course: Course) -> Drift:
    """Moved: a knock was told lately. Suspected: the last session disagrees."""
    last = len(seen) - 1
    if course.knocked is not None and last - course.knocked < _RECENT:
        return Drift(DriftState.MOVED, seen[course.knocked].session_id)
    agrees = sum(regime.probability * regime.right[-1] for regime in course.regimes if regime.start < last)
    if last > 0 and 1 - agrees >= _SUSPECTED:
        return Drift(DriftState.SUSPECTED, seen[last].session_id)
    return Drift(DriftState.STEADY)


def _explain(seen: list[Observation], main: Regime, sides: Sides) -> dict[str, str]:
    reasons = {
        one.session_id: f"The camera has moved since, with session {seen[main.start].session_id}."
        for one in seen[: main.start]
    }
    for one, right in zip(seen[main.start :], main.right, strict=True):
        if right < _WRONG:
            off = difference(one.base_T_correction, sides.correction(one.base_T_camera), one.centroid)
            turn, shift = np.degrees(np.linalg.norm(off[:3])), 1000 * np.linalg.norm(off[3:])
            reasons[one.session_id] = f"It disagrees with the other sessions, by {shift:.1f} mm and {turn:.1f} deg."
    return reasons
