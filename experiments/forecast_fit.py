"""Fits the coefficients of `pretouch_orchestrator.sessions.forecast` by penalised maximum likelihood.

A session with the strictest tolerance and the largest budget tells what would have become of it with any other: it is
cut where it would have converged, or where its budget would not have lasted for the next scan. (The planner would have
planned a little otherwise: it looks at tolerance and budget.)
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import product
from typing import NamedTuple, Protocol

import numpy as np
from pretouch_orchestrator.sessions.forecast import ENOUGH_SCANS, ENOUGH_SECONDS, Features
from scipy.optimize import minimize
from scipy.special import expit

from pretouch.geometry import Array

TOLERANCES = (0.002, 0.003, 0.005, 0.008, 0.012)
SCANS = (2, 4, 10)
SECONDS = (15.0, 40.0, 120.0)
_RIDGE = 0.1
"""Precision of a normal prior of each coefficient but the constant; of 0.1, 0.3, 1 and 3 the best on sessions left out
(eight folds of the training sessions)."""


class Course(Protocol):
    """What is fitted of a session: see `experiments.forecast.Row`."""

    @property
    def tolerance(self) -> float: ...

    @property
    def features(self) -> list[list[float]]: ...

    @property
    def spent(self) -> list[float]: ...

    @property
    def durations(self) -> list[float]: ...

    @property
    def quantiles(self) -> list[float]: ...

    @property
    def explained(self) -> list[bool]: ...

    @property
    def seconds(self) -> float: ...


class Cut(NamedTuple):
    """A session as it would have gone: features (k, 8) of its states, what each still took (k,), and whether it
    converged.
    """

    features: Array
    scans: Array
    seconds: Array
    converged: bool


def cut(course: Course, tolerance: float, scans: int, seconds: float) -> Cut:
    """The session with another tolerance, m, and another budget."""
    spent = [*course.spent, course.seconds]
    states, converged, end = [], False, 0
    for k, (quantile, explained) in enumerate(zip(course.quantiles, course.explained, strict=True)):
        end = k
        converged = explained and quantile <= tolerance
        last = k == len(course.features)
        if converged or last or k >= scans or spent[k] + course.durations[k] > seconds:
            break
        known = Features(*course.features[k])
        states.append(
            known._replace(
                need=np.log(quantile / tolerance),
                scans=np.log(min(scans - k, ENOUGH_SCANS)),
                seconds=np.log(np.clip((seconds - spent[k]) / course.durations[k], 1.0, ENOUGH_SECONDS)),
                tolerance=np.log(1000.0 * tolerance),
            )
        )
    made = np.arange(len(states))
    return Cut(
        np.array(states, dtype=np.float64).reshape(-1, len(Features._fields)),
        (end - made).astype(np.float64),
        spent[end] - np.array(spent)[made],
        converged,
    )


def cut_all(courses: Sequence[Course]) -> Iterator[Cut]:
    """Every session with every tolerance and budget, without those that have converged, or end, before a scan."""
    for course, tolerance, scans, seconds in product(courses, TOLERANCES, SCANS, SECONDS):
        made = cut(course, tolerance, scans, seconds)
        if len(made.features):
            yield made


def fit_coefficients(courses: Sequence[Course]) -> str:
    """The coefficients as lines of Python. Each state counts; with all its cuts a session counts as one."""
    cuts = list(cut_all(courses))
    x = np.concatenate([each.features for each in cuts])
    weights = np.full(len(x), len(courses) / len(cuts))
    converged = np.concatenate([np.full(len(each.features), float(each.converged)) for each in cuts])
    scans = np.concatenate([each.scans for each in cuts])
    seconds = np.concatenate([each.seconds for each in cuts])
    left = np.exp(x[:, Features._fields.index("scans")])
    share = _fit(x, lambda z: left * np.logaddexp(0.0, z) - scans * z, weights)
    made = np.maximum(1.0, left * expit(x @ share))
    fits = {
        "CHANCE": _fit(x, lambda z: np.logaddexp(0.0, z) - converged * z, weights),
        "SCANS": share,
        "SECONDS": _fit(x, lambda z: (made * np.exp(z) - seconds * z) / seconds.mean(), weights),
    }
    lines = [
        f"# {len(courses)} sessions, cut to {len(cuts)}, {np.mean([each.converged for each in cuts]):.0%} converge"
    ]
    for name, values in fits.items():
        lines.append(f"{name}: Final = Features({', '.join(f'{value:.2f}' for value in values)})")
    return "\n".join(lines)


def _fit(x: Array, loss: Callable[[Array], Array], weights: Array) -> Array:
    """The coefficients (8,) that minimise the weighted sum of `loss` of the linear predictors, and the ridge."""
    scale = np.array([0.0, *[_RIDGE] * (len(Features._fields) - 1)])

    def objective(coefficients: Array) -> float:
        return float(weights @ loss(np.clip(x @ coefficients, -10, 10)) + 0.5 * scale @ coefficients**2)

    return np.asarray(minimize(objective, np.zeros(len(scale)), method="BFGS").x, dtype=np.float64)
