"""Forecasts what the rest of a session will take, from what its record tells once the next scan is planned.

Three generalised linear models of the same features (McCullagh and Nelder, Generalized Linear Models, 1989): logistic
for the chance to converge and for the share of the scans left that will be made (a fractional response, Papke and
Wooldridge 1996), and Poisson with a log link for the robot seconds that a scan will take. The coefficients were fitted
to simulated sessions in two worlds by

    python -m experiments.forecast --split train --fit

which prints them; docs/results/forecast.md says how well they did on other objects.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from scipy.special import expit

from pretouch.session import Forecast
from pretouch_orchestrator.sessions.endings import error_quantile
from pretouch_orchestrator.sessions.record import Record


class Features(NamedTuple):
    """What is known of a session that awaits a scan.

    Attributes:
        constant: 1.
        need: log of the ratio of the error's quantile to the tolerance.
        gain: decrease of the log expected error that is predicted of a scan of the best region.
        scans: log of the number of scans that the budget has left, at most ENOUGH_SCANS.
        seconds: log of the ratio of the robot seconds that the budget has left to those of the next scan, at most
            ENOUGH_SECONDS.
        tolerance: log of the tolerance in millimetres.
        cone: half angle of the sensor's beam, in units of 0.1 rad.
        begun: whether a scan was made.
    """

    constant: float
    need: float
    gain: float
    scans: float
    seconds: float
    tolerance: float
    cone: float
    begun: float


CHANCE: Final = Features(-3.53, -3.19, 3.72, 1.38, 0.24, 0.71, -0.89, 0.03)
SCANS: Final = Features(2.09, 0.95, -0.57, -2.15, 0.52, 0.26, -0.08, -0.43)
SECONDS: Final = Features(1.07, 0.08, -0.45, 0.06, -0.16, 0.09, 0.03, -0.05)
"""Coefficients of the logits of the chance and of the share of the scans left, and of the log of the seconds a scan."""
ENOUGH_SCANS: Final = 10.0
ENOUGH_SECONDS: Final = 30.0
"""Budgets beyond these change nothing."""
_MAX_LOG: Final = 10.0
_LEAST: Final = 1e-9
"""m: smaller errors and tolerances count as this one."""


def describe(record: Record) -> Features:
    """The features of a session whose next scan is planned."""
    assert record.next_scan is not None
    request, estimate = record.request, record.estimate
    scans, seconds = measure_rest(record)
    best = min((region.expected_error for region in record.regions), default=estimate.expected_error)
    return Features(
        constant=1.0,
        need=float(np.log(max(error_quantile(record), _LEAST) / max(request.tolerance.error, _LEAST))),
        gain=float(max(np.log(estimate.expected_error / best), 0.0)),
        scans=float(np.log(min(scans, ENOUGH_SCANS))),
        seconds=float(np.log(np.clip(seconds / record.next_scan.path.duration, 1.0, ENOUGH_SECONDS))),
        tolerance=float(np.log(1000.0 * max(request.tolerance.error, _LEAST))),
        cone=10.0 * request.sensor.beam_half_angle,
        begun=float(bool(record.scans)),
    )


def add_forecast(record: Record) -> Record:
    """The session, whose next scan is planned, with its forecast."""
    return replace(record, forecast=compute_forecast(describe(record), *measure_rest(record)))


def measure_rest(record: Record) -> tuple[int, float]:
    """The scans and the robot seconds that the budget has left."""
    budget, used = record.request.budget, record.budget_used
    return budget.scans - used.scans, budget.seconds - used.seconds


def compute_forecast(features: Features, scans: int, seconds: float) -> Forecast:
    """The forecast where the budget has so many scans and robot seconds left: at least the planned scan is made."""
    x = np.array(features)
    made = max(1.0, min(scans, ENOUGH_SCANS) * float(expit(x @ SCANS)))
    return Forecast(
        scans=made,
        seconds=min(seconds, made * float(np.exp(np.clip(x @ SECONDS, -_MAX_LOG, _MAX_LOG)))),
        chance=float(expit(x @ CHANCE)),
    )
