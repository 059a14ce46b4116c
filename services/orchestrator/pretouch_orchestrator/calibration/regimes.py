"""A filter over the sessions of a camera that may have been knocked at any time between two of them.

Bayesian online changepoint detection (Adams & MacKay 2007, arXiv:0710.3742): a regime for each session with which the
present state of the camera may have begun; in it, for each pair of residual standard deviations on a grid, a Kalman
filter of both sides' errors. A session's noise is a mixture: its stated covariance at several scales, and that of a
wrong session; after each session the mixture is collapsed to its mean and covariance (as in Gaussian sum filters).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from pretouch.geometry import Array, Pose, vector_from_rotation
from pretouch_orchestrator.calibration import assumptions

_MAX_REGIMES = 5
_MIN_WEIGHT = 1e-3
_SETTLED = 3
"""Sessions that must be known of a state before a knock can end it."""

_ABOUT_CAMERA, _ROTATIONS, _TRANSLATIONS = (
    grid.ravel()
    for grid in np.meshgrid([False, True], assumptions.ROTATION_STDS, assumptions.TRANSLATION_STDS, indexing="ij")
)
_GRID_WEIGHTS = np.log(
    [
        np.outer((1 - assumptions.ABOUT_CAMERA) * assumptions.ROTATION_WEIGHTS, assumptions.TRANSLATION_WEIGHTS),
        np.outer(assumptions.ABOUT_CAMERA * assumptions.CAMERA_ROTATION_WEIGHTS, assumptions.TRANSLATION_WEIGHTS),
    ]
).ravel()
_CLASS_WEIGHTS = np.log(
    np.concatenate(
        [assumptions.NOISE_WEIGHTS, np.full(len(assumptions.WRONG), assumptions.WRONG_WEIGHT / len(assumptions.WRONG))]
    )
)
_RIGHT = len(assumptions.NOISE_WEIGHTS)
_WALK, _PUSH = (
    np.diag(np.tile([rotation**2] * 3 + [translation**2] * 3, 2))
    for rotation, translation in (
        (assumptions.WALK_ROTATION, assumptions.WALK_TRANSLATION),
        (assumptions.PUSH_ROTATION, assumptions.PUSH_TRANSLATION),
    )
)


class Reading(NamedTuple):
    """A session's evidence about changes of both sides, linear around some values of them.

    Attributes:
        base_T_camera: the declared pose.
        jacobian: (k, 12).
        values: (k,), the observed ones less those expected without any change.
        variances: (k,), of the session's own errors.
        rows: (k, 6), how errors of the correction act on the values.
        camera_rows: (k, 3), how rotations about the camera's origin do.
    """

    base_T_camera: Pose
    jacobian: Array
    values: Array
    variances: Array
    rows: Array
    camera_rows: Array


@dataclass
class _Regime:
    """Attributes: weights (g,), logarithms; means (g, 12); covariances (g, 12, 12); right: by reading since `start`,
    the probability that its session is not simply wrong."""

    start: int
    weights: Array
    means: Array
    covariances: Array
    pose: Pose
    fixed: bool = True
    right: list[float] = field(default_factory=list)

    def weight(self) -> float:
        return float(np.logaddexp.reduce(self.weights))


class ResidualVariances(NamedTuple):
    """What differs from session to session: the variances along each axis, in rad^2 and m^2.

    Attributes:
        turn: of rotations about the object.
        camera_turn: of rotations about the camera's origin.
        shift: of translations.
    """

    turn: float
    camera_turn: float
    shift: float

    def covariance(self, rows: Array, camera_rows: Array) -> Array:
        """(k, k), of the values that `rows` (k, 6) and `camera_rows` (k, 3) make of it (`Reading`)."""
        about_object = (rows * np.repeat([self.turn, self.shift], 3)) @ rows.T
        return np.asarray(about_object + self.camera_turn * camera_rows @ camera_rows.T, dtype=np.float64)


class Regime(NamedTuple):
    """A possible beginning of the camera's present state.

    Attributes:
        start: number of the reading with which it began.
        probability: of this beginning.
        mean, covariance: (12,), (12, 12), of the changes of both sides at the next session.
        residual: of what differs from session to session.
        right: by reading since `start`, the probability that its session is not simply wrong.
        pose: the declared pose of all its readings, None if there are several.
    """

    start: int
    probability: float
    mean: Array
    covariance: Array
    residual: ResidualVariances
    right: tuple[float, ...]
    pose: Pose | None


def is_same_place(a: Pose, b: Pose) -> bool:
    """Whether two declared poses are the same but for joint noise."""
    moved = float(np.linalg.norm(a.translation - b.translation))
    turned = float(np.linalg.norm(vector_from_rotation(a.rotation.T @ b.rotation)))
    return moved <= assumptions.SAME_POSITION and turned <= assumptions.SAME_ROTATION


class Course(NamedTuple):
    """What the filter found along the sessions.

    Attributes:
        regimes: the possible beginnings of the present state, the most probable first.
        knocked: number of the reading with which the last knock that was told began, None if there was none.
        surprises: by reading, the squared innovation under what the readings before predicted, by its expectation: near
            1 if they predict as well as they state. None where nothing was predicted.
    """

    regimes: list[Regime]
    knocked: int | None
    surprises: tuple[float | None, ...]


def filter_regimes(readings: list[Reading], mean: Array, covariance: Array) -> Course:
    """Follows the camera's state along the sessions.

    A knock is told as soon as two sessions or more say so, after three others: where the probability that the present
    state began with one of them reaches `assumptions.MOVED`. What was known before counts no longer then.

    Args:
        readings: of the sessions, in order; at least one.
        mean: (12,), prior of the changes of both sides.
        covariance: (12, 12), its.
    """
    regimes: list[_Regime] = []
    knocked: int | None = None
    surprises = []
    for k, reading in enumerate(readings):
        surprises.append(_surprise(regimes, reading))
        regimes += _begin(k, regimes, reading, (mean, covariance))
        _update(regimes, reading)
        regimes = _prune(regimes)
        late = [regime for regime in regimes if (knocked or 0) + _SETTLED <= regime.start < k]
        if sum(np.exp(regime.weight()) for regime in late) >= assumptions.MOVED:
            knocked = late[0].start
            regimes = _prune([regime for regime in regimes if regime.start >= knocked])
    return Course([_summarise(regime) for regime in regimes], knocked, tuple(surprises))


def _surprise(regimes: list[_Regime], reading: Reading) -> float | None:
    """See `Course.surprises`."""
    if not regimes:
        return None
    each = [_summarise(regime) for regime in regimes]
    weights = np.array([[one.probability] for one in each])
    means, covariances = (np.stack([getattr(one, name) for one in each]) for name in ("mean", "covariance"))
    mean, covariance = mix(weights, means[:, None], covariances[:, None])
    residual = mean_residual(each).covariance(reading.rows, reading.camera_rows)
    expected = reading.jacobian @ covariance[0] @ reading.jacobian.T + residual + np.diag(reading.variances)
    innovation = reading.values - reading.jacobian @ mean[0]
    return float(innovation @ np.linalg.solve(expected, innovation)) / len(innovation)


def _begin(k: int, regimes: list[_Regime], reading: Reading, prior: tuple[Array, Array]) -> list[_Regime]:
    """Regimes that begin with reading k, their weights taken from those that they would end.

    A camera that was pushed a little is near where it was; in a second one nothing is left of what was known. What
    differs from session to session is partly as it was before, partly as of any camera.
    """
    fresh = np.tile(prior[0], (len(_GRID_WEIGHTS), 1)), np.tile(prior[1], (len(_GRID_WEIGHTS), 1, 1))
    if not regimes:
        return [_Regime(k, _GRID_WEIGHTS, *fresh, reading.base_T_camera)]
    born, ended = [], []
    for regime in regimes:
        same = is_same_place(regime.pose, reading.base_T_camera)
        chance = assumptions.KNOCK
        if regime.fixed and not same and len(regime.right) >= assumptions.FIXED_SESSIONS:
            chance = assumptions.REDECLARED
        elif len(regime.right) == 1:  # a regime of one wrong session: what follows is the first one's right beginning
            chance = assumptions.KNOCK + assumptions.WRONG_WEIGHT
        inherited = regime.weights + np.log(assumptions.INHERITED)
        anew = regime.weight() + np.log1p(-assumptions.INHERITED) + _GRID_WEIGHTS
        born.append(np.log(chance) + np.logaddexp(inherited, anew))
        ended.append(regime.weights)
        regime.weights = regime.weights + np.log1p(-chance)
        regime.fixed = regime.fixed and same
    weights = np.logaddexp.reduce(born, axis=0)
    shares = np.exp(np.stack(ended) - np.logaddexp.reduce(ended, axis=0))
    means, covariances = mix(
        shares, np.stack([regime.means for regime in regimes]), np.stack([regime.covariances for regime in regimes])
    )
    return [
        _Regime(k, weights + np.log(1 - assumptions.PUSHED), *fresh, reading.base_T_camera),
        _Regime(k, weights + np.log(assumptions.PUSHED), means, covariances + _PUSH, reading.base_T_camera),
    ]


def _update(regimes: list[_Regime], reading: Reading) -> None:
    means = np.stack([regime.means for regime in regimes])
    covariances = np.stack([regime.covariances for regime in regimes])
    across = covariances @ reading.jacobian.T
    of_rotation, of_translation, about_camera = (
        rows @ rows.T for rows in (reading.rows[:, :3], reading.rows[:, 3:], reading.camera_rows)
    )
    turned = np.where(_ABOUT_CAMERA[:, None, None], about_camera, of_rotation)
    residual = _ROTATIONS[:, None, None] ** 2 * turned + _TRANSLATIONS[:, None, None] ** 2 * of_translation
    own = np.diag(reading.variances)
    noise = np.stack(
        [scale**2 * own for scale in assumptions.NOISE_SCALES]
        + [
            own + off.rotation_std**2 * of_rotation + off.translation_std**2 * of_translation
            for off in assumptions.WRONG
        ]
    )
    innovation = reading.values - means @ reading.jacobian.T
    information = np.linalg.inv((reading.jacobian @ across + residual)[:, :, None] + noise)
    pulls = (information @ innovation[:, :, None, :, None])[..., 0]
    fits = np.linalg.slogdet(information)[1] - (pulls * innovation[:, :, None]).sum(axis=-1)
    scores = 0.5 * fits + _CLASS_WEIGHTS
    first = [k for k, regime in enumerate(regimes) if not regime.right]
    scores[first, :, _RIGHT:] = -np.inf  # that the first one is wrong is the regime that begins with the next
    totals = np.logaddexp.reduce(scores, axis=-1)
    shares = np.exp(scores - totals[..., None])
    pull = np.einsum("rgc,rgck->rgk", shares, pulls)
    spread = np.einsum("rgc,rgck,rgcl->rgkl", shares, pulls, pulls) - pull[..., :, None] * pull[..., None, :]
    less = np.einsum("rgc,rgckl->rgkl", shares, information) - spread
    means = means + (across @ pull[..., None])[..., 0]
    covariances = covariances - across @ less @ np.swapaxes(across, -1, -2) + _WALK
    for k, regime in enumerate(regimes):
        regime.weights = regime.weights + totals[k]
        regime.means, regime.covariances = means[k], covariances[k]
        grid = np.exp(regime.weights - regime.weight())
        regime.right.append(float(grid @ shares[k, :, :_RIGHT].sum(axis=-1)))


def _prune(regimes: list[_Regime]) -> list[_Regime]:
    ordered = sorted(regimes, key=_Regime.weight, reverse=True)
    total = np.logaddexp.reduce([regime.weight() for regime in ordered])
    for regime in ordered:
        regime.weights = regime.weights - total
    return [regime for regime in ordered[:_MAX_REGIMES] if regime.weight() > np.log(_MIN_WEIGHT)]


def _summarise(regime: _Regime) -> Regime:
    grid = np.exp(regime.weights - regime.weight())
    mean, covariance = mix(grid[:, None], regime.means[:, None], regime.covariances[:, None])
    return Regime(
        start=regime.start,
        probability=float(np.exp(regime.weight())),
        mean=mean[0],
        covariance=covariance[0],
        residual=ResidualVariances(
            turn=float(grid @ np.where(_ABOUT_CAMERA, 0.0, _ROTATIONS**2)),
            camera_turn=float(grid @ np.where(_ABOUT_CAMERA, _ROTATIONS**2, 0.0)),
            shift=float(grid @ _TRANSLATIONS**2),
        ),
        right=tuple(regime.right),
        pose=regime.pose if regime.fixed else None,
    )


def mean_residual(regimes: Sequence[Regime]) -> ResidualVariances:
    """By the regimes' probabilities."""
    weights = [regime.probability for regime in regimes]
    turn, camera_turn, shift = np.average([regime.residual for regime in regimes], axis=0, weights=weights)
    return ResidualVariances(float(turn), float(camera_turn), float(shift))


def mix(weights: Array, means: Array, covariances: Array) -> tuple[Array, Array]:
    """Means (m, d) and covariances (m, d, d) of m mixtures of n normal distributions each.

    Args:
        weights: (n, m), any sum.
        means: (n, m, d).
        covariances: (n, m, d, d).
    """
    weights = weights / weights.sum(axis=0)
    mean = (weights[..., None] * means).sum(axis=0)
    off = means - mean
    covariance = (weights[..., None, None] * (covariances + off[..., :, None] * off[..., None, :])).sum(axis=0)
    return mean, 0.5 * (covariance + np.swapaxes(covariance, -1, -2))
