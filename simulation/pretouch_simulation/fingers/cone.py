"""`cone`: a fingertip described as 25 deg wide, which mostly reads the nearest part of its spot.

Every such finger is described alike; its true parameters vary, as those of modules of one type do.
"""

from __future__ import annotations

import numpy as np

from pretouch.tof import Sensor
from pretouch_simulation.fingers.cone_finger import ConeFinger, Errors
from pretouch_simulation.fingers.cone_response import ConeResponse, Estimator, Reflectances
from pretouch_simulation.fingers.range_curve import RangeCurve
from pretouch_simulation.fingers.spot import Spot

SENSOR = Sensor(range_min=0.01, range_std=0.002, beam_half_angle=float(np.radians(12.5)))
"""As the client describes it."""
_SPAN = (SENSOR.range_min, SENSOR.range_max)
WIDTH = (0.8, 1.25)
"""The true half angle over the described one."""
NEARNESS = (0.007, 0.014)
"""m."""
MEAN_SHARE = 0.5
"""Share of fingers that report the mean; the others report the first or the strongest peak."""
BIAS = 0.0007
"""m."""
GAIN = 0.005
BEND = np.array([0.1, 0.1, 0.2, 0.2]) * 1e-3
"""m rms by degree: what a cubic leaves of a TMF8820 (docs/results/fingers.md)."""
DARKEST = 0.25
"""The reflectance of the darkest thing, against the wall that the module was calibrated on."""


def draw(rng: np.random.Generator) -> ConeFinger:
    """A finger of the family."""
    half_angle = SENSOR.beam_half_angle * float(rng.uniform(*WIDTH))
    nearness = float(np.exp(rng.uniform(*np.log(NEARNESS))))
    peaks = (1 - MEAN_SHARE) / 2
    estimator = Estimator(rng.choice([*Estimator], p=[MEAN_SHARE, peaks, peaks]))
    errors = Errors(
        noise=0.0015,
        bias=BIAS,
        curve=RangeCurve(_SPAN, float(GAIN * rng.standard_normal()), tuple((BEND * rng.standard_normal(4)).tolist())),
        step=0.001,
        least_range=0.01,
        least_signal=0.05,
        flagged=0.01,
        outliers=0.003,
    )
    reflectances = Reflectances.draw(DARKEST, rng)
    return ConeFinger(SENSOR, ConeResponse(Spot(half_angle), nearness, estimator), errors, reflectances)
