"""Fits a module's calibration to its readings at known distances."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from pretouch.errors import InvalidInput
from pretouch.geometry import Array
from pretouch_sensor_gateway.calibration.bend import Curve, choose_curve, tabulate
from pretouch_sensor_gateway.calibration.model import EVERYWHERE, ModuleCalibration
from pretouch_sensor_gateway.calibration.noise import LEAST_STD, SIGNIFICANT, fit_noise
from pretouch_sensor_gateway.calibration.readings import find_step, reject_outliers
from pretouch_sensor_gateway.calibration.record import ModuleFit, Point, StandardErrors

PLACEMENT_STD = 0.0002
"""m, how exactly a plate is placed by hand against gauge blocks or a calliper. It keeps the standard errors of a fit to
thousands of readings realistic, and is their only source where there are no more distances than parameters."""
_START = (0.0, 1.0, 0.0)
_SCALES = (1e-3, 1e-2, 1.0)
_MOST_GLASS = 0.9
"""Of the target's own light: the farthest distance stays within the reach, and the curve can be inverted."""


def fit_module(readings: Mapping[float, Array]) -> ModuleFit:
    """Fits the model of `model.py` to readings at one distance or more.

    One distance determines the offset, two the scale too. Three or more determine the crosstalk, which is kept only if
    it exceeds two of its standard errors; else it is exactly 0 and the other parameters are fitted without it. Five or
    more may determine a bend, if that predicts distances left out better than the line or the crosstalk (`bend.py`);
    then the crosstalk is 0. The residual is the error of such predictions, less noise and rounding.

    Standard errors come from the readings' noise, their steps, and `PLACEMENT_STD`; if the residuals are larger than
    these explain, they grow accordingly.

    Args:
        readings: distance in m -> readings (n,), m, finite, of status 0; a distance without readings is ignored.
    """
    measured = {distance: values for distance, values in sorted(readings.items()) if len(values)}
    if not measured:
        return ModuleFit(problem="It returned too little at every distance.")
    step = find_step(measured.values())
    points = tuple(reject_outliers(distance, values, step) for distance, values in measured.items())
    values, errors = _curve(points, step)
    try:
        curve, errors = _bend_if_better(points, step, _straight(values), errors)
        noise = fit_noise(points, curve, step)
        calibration = replace(curve, std=round(max(noise.std, LEAST_STD), 7), std_slope=round(noise.std_slope, 6))
    except InvalidInput as error:
        return ModuleFit(step=step, points=points, problem=f"{error.detail} {error.remedy}")
    standard_errors = StandardErrors(**errors, std=round(noise.std_error, 7), std_slope=round(noise.std_slope_error, 6))
    return ModuleFit(calibration, standard_errors, step, tuple(_add_residuals(point, curve) for point in points))


def _bend_if_better(
    points: Sequence[Point], step: float, straight: ModuleCalibration, standard_errors: dict[str, float]
) -> tuple[ModuleCalibration, dict[str, float]]:
    """The curve without a bend or the one with the best, and its line's standard errors: see `choose_curve`."""
    r = np.array([point.distance for point in points])
    means = np.array([point.mean for point in points])
    errors = np.array([_error_of_mean(point, step) for point in points])
    span = EVERYWHERE if len(points) == 1 else (float(r[0]), float(r[-1]))
    free = 3 if straight.crosstalk else 2
    if len(points) <= free:
        return replace(straight, span=span), standard_errors

    def solve_straight(kept: NDArray[np.int64]) -> Curve:
        parameters, _ = _solve(r[kept], means[kept], errors[kept], free)
        return _straight([*parameters, *_START[free:]]).predict_reading

    chosen, off = choose_curve(r, means, errors, solve_straight)
    noise = np.array([_noise_of_mean(point, step) for point in points])
    if chosen is not None:
        line, line_errors = _solve(r, means, errors, 2)
        straight, standard_errors = _straight([*line, _START[2]]), _name_parameters([*line_errors, 0.0])
        straight = replace(straight, corrections=tabulate(chosen, straight, span))
    variance = float(np.mean((off**2 - noise**2) * straight.gain(r) ** 2))
    residual = max(variance, 0.0) ** 0.5
    return replace(straight, residual=round(residual, 7), span=span), standard_errors


def _straight(numbers: Sequence[float]) -> ModuleCalibration:
    """Of offset, scale and crosstalk."""
    named = _name_parameters(numbers)
    return ModuleCalibration(named["offset"], named["scale"], named["crosstalk"])


def _curve(points: Sequence[Point], step: float) -> tuple[list[float], dict[str, float]]:
    """Offset, scale and crosstalk, and their standard errors by name."""
    r = np.array([point.distance for point in points])
    means = np.array([point.mean for point in points])
    errors = np.array([_error_of_mean(point, step) for point in points])
    found = _solve(r, means, errors, min(len(points), 3))
    if len(points) >= 3 and found[0][2] <= SIGNIFICANT * found[1][2]:
        found = _solve(r, means, errors, 2)
    return [*found[0], *_START[len(found[0]) :]], _name_parameters([*found[1], 0.0, 0.0])


def _name_parameters(numbers: Sequence[float]) -> dict[str, float]:
    """The parameters by name, rounded to significant digits."""
    digits = {"offset": 7, "scale": 6, "crosstalk": 4}
    return {name: round(float(number), places) for (name, places), number in zip(digits.items(), numbers, strict=False)}


def _error_of_mean(point: Point, step: float) -> float:
    """One standard deviation of the mean reading about the model, m.

    Noise of half a step or more averages the rounding out; without noise it stays. What is left of its step / sqrt(12)
    falls as exp(-2 pi^2 (std / step)^2) (Widrow and Kollar, Quantization Noise, 2008: the first harmonic).
    """
    return float(np.hypot(_noise_of_mean(point, step), PLACEMENT_STD))


def _noise_of_mean(point: Point, step: float) -> float:
    """The part of it that is noise and rounding."""
    rounding = 0.0
    if step:
        rounding = step / np.sqrt(12) * np.exp(-2 * (np.pi * point.std / step) ** 2)
    return float(np.sqrt(max(point.std, LEAST_STD) ** 2 / point.samples + rounding**2))


def _solve(r: Array, means: Array, errors: Array, free: int) -> tuple[Array, Array]:
    """The first `free` parameters of offset, scale and crosstalk by weighted least squares, and standard errors."""

    def whole(parameters: Array) -> Array:
        return np.array([*parameters, *_START[free:]])

    def residuals(parameters: Array) -> Array:
        offset, scale, crosstalk = whole(parameters)
        return np.asarray((offset + scale * r / (1 + crosstalk * r**2) - means) / errors)

    def jacobian(parameters: Array) -> Array:
        _, scale, crosstalk = whole(parameters)
        light = 1 + crosstalk * r**2
        columns = np.stack([np.ones_like(r), r / light, -scale * r**3 / light**2], axis=1)
        return np.asarray(columns[:, :free] / errors[:, None])

    most = _MOST_GLASS / r.max() ** 2
    result = least_squares(
        residuals,
        _START[:free],
        jacobian,
        bounds=((-np.inf, -np.inf, -most)[:free], (np.inf, np.inf, most)[:free]),
        x_scale=_SCALES[:free],
    )
    covariance = np.linalg.inv(result.jac.T @ result.jac)
    spare = len(r) - free
    unexplained = max(1.0, 2 * result.cost / spare) if spare else 1.0
    return np.asarray(result.x), np.sqrt(np.diag(covariance) * unexplained)


def _add_residuals(point: Point, model: ModuleCalibration) -> Point:
    r = np.array(point.distance)
    residual = float((point.mean - model.predict_reading(r)) * model.gain(r))
    return Point(point.distance, point.mean, point.std, point.samples, point.outliers, round(residual, 7))
