"""Curves that bend: chosen by how well they predict the readings at distances that were left out."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from pretouch.geometry import Array
from pretouch_sensor_gateway.calibration.model import ModuleCalibration

Curve = Callable[[Array], Array]
"""Readings, m, at distances, m."""

_KNOTS = (3, 4, 5, 6, 8, 10)
_PER_KNOT = 3
"""Distances for each knot, at least; three knots need five."""
_FEWEST = 5
_BLOCKS = 8
"""Into which the inner distances are split by order; one block of neighbours is left out at a time, because the errors
of neighbours are alike. The outermost distances always stay: beyond them no calibration is said to hold."""
_TOLERANCE = 3.0
"""Standard deviations that a mean square of errors, of expectation 1, may be larger."""
_NEAR = 1.2
"""Times the least."""
_ROWS = 24
_DIGITS = 7


def choose_curve(
    distances: Array, readings: Array, errors: Array, solve_straight: Callable[[NDArray[np.int64]], Curve]
) -> tuple[Curve | None, Array]:
    """The best natural cubic spline, or None for the straight curve; and the errors of predictions, m of reading.

    Taken is the curve with the fewest parameters whose errors of prediction the stated errors explain, or whose mean
    square error of prediction is near the least. Splines that do not grow with the distance are left out.

    Args:
        distances: (n,), ascending, n > 2.
        readings, errors: (n,), means and their standard errors.
        solve_straight: fits the straight curve to the distances with these indices.

    Returns:
        The curve; and (n,) what each reading is off: by a fit without it and its neighbours, and the outermost, which
        nothing predicts but an extrapolation, by the whole fit.
    """
    n = len(distances)
    everything = np.arange(n)
    blocks = [block for block in np.array_split(everything[1:-1], _BLOCKS) if len(block)]

    def predict(solve: Callable[[NDArray[np.int64]], Curve]) -> Array:
        off = readings - solve(everything)(distances)
        for block in blocks:
            off[block] = readings[block] - solve(np.setdiff1d(everything, block))(distances[block])
        return off

    curves: list[Curve | None] = [None]
    offs = [predict(solve_straight)]
    for count in _KNOTS:
        if n < _FEWEST or count > max(n // _PER_KNOT, _KNOTS[0]):
            break
        knots = np.linspace(distances[0], distances[-1], count)

        def solve(kept: NDArray[np.int64], knots: Array = knots) -> Curve:
            return _solve_spline(knots, distances[kept], readings[kept], errors[kept])

        curve = solve(everything)
        if (np.diff(curve(np.linspace(distances[0], distances[-1], 200))) > 0).all():
            curves.append(curve)
            offs.append(predict(solve))
    scores = [float(np.mean((off / errors) ** 2)) for off in offs]
    enough = max(1 + _TOLERANCE * np.sqrt(2 / n), _NEAR * min(scores))
    chosen = next(k for k, score in enumerate(scores) if score <= enough)
    return curves[chosen], offs[chosen]


def _solve_spline(knots: Array, distances: Array, readings: Array, errors: Array) -> Curve:
    """Weighted least squares of a natural cubic spline's values at its knots."""
    unit = CubicSpline(knots, np.eye(len(knots)), bc_type="natural")
    values, *_ = np.linalg.lstsq(unit(distances) / errors[:, None], readings / errors, rcond=None)
    return lambda r: np.asarray(unit(r) @ values)


def tabulate(curve: Curve, straight: ModuleCalibration, span: tuple[float, float]) -> tuple[tuple[float, float], ...]:
    """The corrections that make of a straight calibration one that follows the curve over the span."""
    r = np.linspace(*span, _ROWS)
    places = straight.distance(curve(r))
    return tuple((round(float(p), _DIGITS), round(float(d), _DIGITS)) for p, d in zip(places, r - places, strict=True))
