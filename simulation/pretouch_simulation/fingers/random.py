"""`random`: a fingertip with parameters drawn from the ranges below.

Its description has the right kind (beam or cone), the data sheet's half angle and noise, both somewhat wrong, and the
least range, which is easily measured.
"""

from __future__ import annotations

import numpy as np

from pretouch.tof import Sensor
from pretouch_simulation.draws import draw_log_uniform
from pretouch_simulation.fingers.cone_finger import ConeFinger, Errors
from pretouch_simulation.fingers.cone_response import ConeResponse, Estimator, Reflectances
from pretouch_simulation.fingers.range_curve import RangeCurve
from pretouch_simulation.fingers.spot import Profile, Spot

THIN_SHARE = 0.25
"""Share of fingers with a thin beam."""
STATED_HALF_ANGLE = (np.radians(5.0), np.radians(15.0))
WIDTH = (0.8, 1.25)
"""The true half angle over the described one."""
MEAN_SHARE = 0.5
"""Share of cones that report the mean; the others report the first or the strongest peak."""
EVEN_SHARE = 0.25
"""Share of cones that weigh near and far parts alike."""
NEARNESS = (0.003, 0.03)
"""m, of the others."""
PULSE = (0.003, 0.01)
"""m."""
BORESIGHT = float(np.radians(3.0))
NOISE = (0.0005, 0.003)
"""m."""
MISSTATED = 1.5
"""The largest factor by which the described standard deviation is off, either way."""
BIAS = 0.001
"""m, the greatest standard deviation between scans."""
GAIN = 0.01
LINE_LEFT = np.array([0.7, 0.2, 0.2, 0.2]) * 1e-3
"""m rms by degree, from 2 on: what a calibration by a line leaves of a TMF8820 (docs/results/fingers.md)."""
CUBIC_LEFT = np.array([0.1, 0.1, 0.2, 0.2]) * 1e-3
"""The same of a cubic's."""
LEAST_RANGE = (0.008, 0.027)
"""m."""
RANGE_MAX = 0.10
"""m."""
LEAST_SIGNAL = (0.01, 0.06)
DARKEST = 0.15
FLAGGED = 0.03
OUTLIERS = 0.02


def draw(rng: np.random.Generator) -> ConeFinger:
    """A finger; all parameters of `cone_finger` and `cone_response` are drawn."""
    response, stated_half_angle = _draw_response(rng)
    errors = _draw_errors(rng)
    sensor = Sensor(
        range_max=RANGE_MAX,
        range_min=float(np.ceil(errors.least_range * 1000) / 1000),
        range_std=errors.noise * float(MISSTATED ** rng.uniform(-1, 1)),
        beam_half_angle=stated_half_angle,
    )
    return ConeFinger(sensor, response, errors, Reflectances.draw(DARKEST, rng))


def _draw_response(rng: np.random.Generator) -> tuple[ConeResponse, float]:
    """The response, and the half angle of its description, rad."""
    off, about = BORESIGHT * np.sqrt(rng.uniform()), rng.uniform(0, 2 * np.pi)
    boresight = (float(off * np.cos(about)), float(off * np.sin(about)))
    if rng.uniform() < THIN_SHARE:
        return ConeResponse(Spot(0.0, boresight=boresight), np.inf), 0.0
    stated = float(rng.uniform(*STATED_HALF_ANGLE))
    profile = Profile.GAUSSIAN if rng.uniform() < 0.5 else Profile.FLAT
    spot = Spot(stated * float(rng.uniform(*WIDTH)), profile, boresight)
    nearness = np.inf if rng.uniform() < EVEN_SHARE else draw_log_uniform(rng, *NEARNESS)
    peak = Estimator.FIRST_PEAK if rng.uniform() < 0.5 else Estimator.STRONGEST_PEAK
    estimator = Estimator.MEAN if rng.uniform() < MEAN_SHARE else peak
    return ConeResponse(spot, nearness, estimator, draw_log_uniform(rng, *PULSE)), stated


def _draw_errors(rng: np.random.Generator) -> Errors:
    least_range = float(rng.uniform(*LEAST_RANGE))
    left = LINE_LEFT if rng.uniform() < 0.5 else CUBIC_LEFT
    bend = tuple((left * rng.standard_normal(len(left))).tolist())
    return Errors(
        noise=draw_log_uniform(rng, *NOISE),
        bias=float(rng.uniform(0, BIAS)),
        curve=RangeCurve((least_range, RANGE_MAX), float(GAIN * rng.standard_normal()), bend),
        step=0.001 if rng.uniform() < 0.5 else 0.0,
        least_range=least_range,
        least_signal=draw_log_uniform(rng, *LEAST_SIGNAL),
        flagged=float(rng.uniform(0, FLAGGED)),
        outliers=float(rng.uniform(0, OUTLIERS)),
    )
