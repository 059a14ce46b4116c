"""Where a module sits, how late its ranges are, and how wide it sees: from sweeps over a step that is not known.

One least-squares problem of the tip's poses and the ranges. Unknown are the step (its place, height and brightness),
the beam's direction and origin in the tip's frame, the ranges' offset and gain, their latency, the cone's half angle
and how much near parts count for. What no sweep can tell: a turn about the beam; and the origin along the beam, which
is the same as an offset, so it stays where it was and the offset holds both.

The model of the cone is wrong in ways that the ranges share. So the covariance is that of blocks of ranges that follow
one another (the sandwich, Liang and Zeger, 1986), to which the spread between two shapes of the response is added.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, least_squares

from pretouch.errors import InvalidInput
from pretouch.geometry import Array, Pose, rotation_from_vector, rotations_from_vectors, vector_from_rotation
from pretouch_sensor_gateway.calibration.mounting import MAX_HALF_ANGLE, Mounting
from pretouch_sensor_gateway.calibration.sweep_scene import Profile, Response, Step, predict_ranges

LEAST_RANGES = 200
MOST_RANGES = 800
"""Of a longer sweep every second range is used, or every third, and so on."""
LEAST_HEIGHT = 0.004
"""m of the step."""
_BLOCKS = 24
_MODEL_STD = 0.001
"""m: of the ranges about the model, beside their noise."""
_LONGEST_GAP = 0.3
"""s between two poses of one motion."""
_UNKNOWN = 0.6
"""Of what was known before: a parameter whose standard error is larger was not observed."""
_TYPICAL_HALF_ANGLE = 0.15
"""rad, where none is stated."""


class _Parameter(NamedTuple):
    """Its start and the standard deviation of what is known of it before; whether it is one of the module."""

    name: str
    start: float
    prior: float
    own: bool = True


_PARAMETERS = (
    _Parameter("tilt_x", 0.0, 0.1),
    _Parameter("tilt_y", 0.0, 0.1),
    _Parameter("origin_x", 0.0, 0.01),
    _Parameter("origin_y", 0.0, 0.01),
    _Parameter("offset", 0.0, 0.005),
    _Parameter("latency", 0.0, 0.05),
    _Parameter("log_half_angle", 0.0, 0.5),
    _Parameter("decay", 60.0, 80.0),
    _Parameter("gain", 0.0, 0.02),
    _Parameter("log_sharpness", 0.5, 1.0),
    _Parameter("log_brightness", 0.0, 0.7, own=False),
    _Parameter("turn_x", 0.0, 0.3, own=False),
    _Parameter("turn_y", 0.0, 0.3, own=False),
    _Parameter("turn_z", 0.0, 0.3, own=False),
    _Parameter("edge", 0.0, 0.05, own=False),
    _Parameter("level", 0.0, 0.05, own=False),
    _Parameter("height", 0.0, 0.05, own=False),
)
_START = np.array([parameter.start for parameter in _PARAMETERS])
_PRIOR = np.array([parameter.prior for parameter in _PARAMETERS])
_DECAYS = np.array([parameter.name == "decay" for parameter in _PARAMETERS])
"""Which of them cannot be negative."""
_STAGES = (0.004, 0.0)
"""m: standard deviations of the ranges with which it is solved, one after the other, to find the right valley."""
_DIFFERENCE = 0.02
"""Of a standard deviation of what is known before: a step of a derivative."""
OWN = tuple(parameter.name for parameter in _PARAMETERS if parameter.own)
"""Those of a module: `mounting.PARAMETERS`."""


@dataclass(frozen=True, eq=False)
class Sweep:
    """The n ranges of one module in a sweep.

    Attributes:
        t: (n,), s, ascending.
        base_T_tip: (n, 4, 4), the tip's poses at these times by the robot.
        ranges: (n,), m; NaN for none.
    """

    t: Array
    base_T_tip: Array
    ranges: Array


def fit_sweep(sweep: Sweep, tip_T_module: Pose, range_std: float, half_angle: float) -> tuple[Mounting, float]:
    """Fits a module's mount and response.

    Args:
        sweep: over a step at least 4 mm high with a straight edge: forwards and backwards, across the edge at two or
            more heights, with the finger turned about the beam by quarters, and tilted over a flat part.
        tip_T_module: the pose as far as it is known, to a few degrees and 20 mm.
        range_std: of one range, m.
        half_angle: as stated, rad; 0: not known.

    Returns:
        What was found, and the rms, m, of the ranges about the model, without outliers.

    Raises:
        InvalidInput: too few ranges, or no step in them.
    """
    problem = _Problem(sweep, tip_T_module, range_std, half_angle or _TYPICAL_HALF_ANGLE)
    fits = [problem.solve(Profile.ROUND, _START, _STAGES)]
    fits.append(problem.solve(Profile.FLAT, fits[0].values, _STAGES[-1:]))
    best = min(fits, key=lambda fit: fit.cost)
    spread = np.subtract(fits[0].values, fits[1].values)
    covariance = best.covariance + np.outer(spread, spread) / 2
    count = len(OWN)
    std = np.sqrt(np.diag(covariance))[:count]
    values = dict(zip(OWN, best.values[:count].tolist(), strict=True))
    unobserved = tuple(name for name, s, p in zip(OWN, std, _PRIOR[:count], strict=True) if s > _UNKNOWN * p)
    mounting = Mounting(
        problem.mount(best.values),
        values["offset"],
        values["latency"],
        min(problem.half_angle * float(np.exp(values["log_half_angle"])), MAX_HALF_ANGLE),
        max(values["decay"], 0.0),
        covariance[:count, :count],
        unobserved,
    )
    return mounting, best.residual


class _Solution(NamedTuple):
    values: Array
    covariance: Array
    cost: float
    residual: float


class _Problem:
    """The least-squares problem of one module."""

    def __init__(self, sweep: Sweep, tip_T_module: Pose, range_std: float, half_angle: float) -> None:
        returned = np.flatnonzero(np.isfinite(sweep.ranges))
        if len(returned) < LEAST_RANGES:
            raise InvalidInput(
                f"The sweep holds {len(returned)} ranges.", f"Sweep slower or longer: {LEAST_RANGES} are needed."
            )
        returned = returned[:: -(-len(returned) // MOST_RANGES)]
        linear, angular = _find_velocities(sweep)
        self.half_angle = half_angle
        self._tips = sweep.base_T_tip[returned]
        self._linear, self._angular = linear[returned], angular[returned]
        self._ranges = sweep.ranges[returned]
        self._nominal = tip_T_module
        self._std = float(np.hypot(range_std, _MODEL_STD))
        self._step = self._guess_step()

    def _guess_step(self) -> Step:
        """From the points by the nominal mount: two heights, and the line that separates them best."""
        modules = self._tips @ self._nominal.matrix
        points = modules[:, :3, 3] + self._ranges[:, None] * modules[:, :3, 2]
        up = -modules[:, :3, 2].mean(axis=0)
        up /= np.linalg.norm(up)
        heights = points @ up
        low, high = np.percentile(heights, [10, 90])
        for _ in range(20):
            is_high = heights > (low + high) / 2
            if is_high.all() or not is_high.any():
                break
            low, high = np.median(heights[~is_high]), np.median(heights[is_high])
        if high - low < LEAST_HEIGHT or not 0.1 < is_high.mean() < 0.9:
            raise InvalidInput(
                "The sweep shows no step.", "Sweep across the edge of a flat block, as often above it as beside it."
            )
        across = np.linalg.svd(up[None])[2][1:]
        angle, edge = _separate((points @ across.T), is_high)
        x = across.T @ np.array([np.cos(angle), np.sin(angle)])
        place = x * edge
        place += up * (low - place @ up)
        return Step(np.column_stack([x, np.cross(up, x), up]), place, float(high - low), 1.0)

    def mount(self, values: Array) -> Pose:
        tilt = rotation_from_vector([values[0], values[1], 0.0])
        return self._nominal @ Pose.of(tilt, [values[2], values[3], 0.0])

    def _predict(self, values: Array, profile: Profile) -> Array:
        named = dict(zip((parameter.name for parameter in _PARAMETERS), values.tolist(), strict=True))
        late = named["latency"]
        tips = self._tips.copy()
        tips[:, :3, 3] -= late * self._linear
        tips[:, :3, :3] = rotations_from_vectors(-late * self._angular) @ tips[:, :3, :3]
        step = self._step
        turn = rotation_from_vector([named["turn_x"], named["turn_y"], named["turn_z"]])
        step = Step(
            step.rotation @ turn,
            step.translation + step.rotation @ np.array([named["edge"], 0.0, named["level"]]),
            step.height + named["height"],
            float(np.exp(named["log_brightness"])),
        )
        response = Response(
            self.half_angle * float(np.exp(named["log_half_angle"])),
            named["decay"],
            float(np.exp(named["log_sharpness"])),
            profile,
        )
        ranges = predict_ranges(tips @ self.mount(values).matrix, step, response)
        return np.asarray(ranges + named["offset"] + named["gain"] * (ranges - 0.05))

    def solve(self, profile: Profile, start: Array, stds: Sequence[float]) -> _Solution:
        """The solution with one shape of the response, from a start, by ranges of ever smaller standard deviations."""
        scaled = (start - _START) / _PRIOR
        for std in stds:
            found = self._minimise(profile, scaled, max(std, self._std))
            scaled = found.x
        count = len(self._ranges)
        off, slopes = found.fun[:count], found.jac[:count]
        bread = np.linalg.inv(found.jac.T @ found.jac)
        scores = [slopes[block].T @ off[block] for block in np.array_split(np.arange(count), _BLOCKS)]
        fitted = float(np.trace(bread @ (slopes.T @ slopes)))
        few = _BLOCKS / max(_BLOCKS - fitted, 1.0)  # the blocks' scores were made small by the fit itself
        meat = np.eye(len(_START)) + few * np.array(scores).T @ np.array(scores)
        covariance = (bread + bread @ meat @ bread) * np.outer(_PRIOR, _PRIOR)
        values = _START + _PRIOR * scaled
        left = (self._predict(values, profile) - self._ranges)[np.abs(off) < 3]
        return _Solution(values, covariance, float(found.cost), float(np.sqrt(np.mean(left**2))))

    def _minimise(self, profile: Profile, start: Array, std: float) -> OptimizeResult:
        """Least squares of the ranges and of what is known before, in units of its standard deviations."""

        def residuals(scaled: Array) -> Array:
            off = (self._predict(_START + _PRIOR * scaled, profile) - self._ranges) / std
            return np.concatenate([_soften(off), scaled])

        def jacobian(scaled: Array) -> Array:
            steps = _DIFFERENCE * np.eye(len(scaled))
            return np.column_stack(
                [(residuals(scaled + step) - residuals(scaled - step)) / (2 * _DIFFERENCE) for step in steps]
            )

        most = np.full(len(_START), 6.0)
        least = np.where(_DECAYS, -_START / _PRIOR - 1e-9, -most)
        first = np.clip(start, least + 1e-6, most - 1e-6)
        return least_squares(residuals, first, jacobian, bounds=(least, most), max_nfev=25, xtol=1e-4, ftol=1e-4)


def _separate(places: Array, is_high: NDArray[np.bool_]) -> tuple[float, float]:
    """The direction, rad, and the place along it, m, of the line with the fewest of places (n, 2) on its wrong side.

    High ones belong before it, low ones beyond.
    """
    best, found = np.inf, (0.0, 0.0)
    for angle in np.linspace(0.0, 2 * np.pi, 180, endpoint=False):
        along = places @ [np.cos(angle), np.sin(angle)]
        order = np.argsort(along)
        wrong = np.cumsum(np.where(is_high[order], -1, 1))
        if wrong.min() < best:
            best = wrong.min()
            least = np.flatnonzero(wrong == best)
            found = float(angle), float(np.median(along[order][least]))
    return found


def _soften(off: Array) -> Array:
    """Residuals whose squares are the pseudo-Huber loss: an outlier counts by its distance, not by its square."""
    scale = 2.0
    return np.asarray(np.sign(off) * np.sqrt(2 * scale**2 * (np.sqrt(1 + (off / scale) ** 2) - 1)))


def _find_velocities(sweep: Sweep) -> tuple[Array, Array]:
    """The tip's velocities (n, 3), m/s, and turns (n, 3), rad/s, in base; 0 where no pose is close in time."""
    n = len(sweep.t)
    before, after = np.maximum(np.arange(n) - 1, 0), np.minimum(np.arange(n) + 1, n - 1)
    before = np.where(sweep.t - sweep.t[before] <= _LONGEST_GAP, before, np.arange(n))
    after = np.where(sweep.t[after] - sweep.t <= _LONGEST_GAP, after, np.arange(n))
    seconds = sweep.t[after] - sweep.t[before]
    moving = seconds > 0
    share = np.where(moving, 1 / np.where(moving, seconds, 1.0), 0.0)[:, None]
    linear = (sweep.base_T_tip[after, :3, 3] - sweep.base_T_tip[before, :3, 3]) * share
    turned = sweep.base_T_tip[after, :3, :3] @ np.swapaxes(sweep.base_T_tip[before, :3, :3], 1, 2)
    return linear, np.array([vector_from_rotation(each) for each in turned]) * share
