"""Fits the coefficients of `pretouch_orchestrator.sessions.forecast` by penalised maximum likelihood."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from pretouch_orchestrator.sessions.forecast import Features
from scipy.optimize import minimize

from pretouch.geometry import Array

_RIDGE = 0.5
"""Precision of a normal prior of each coefficient but the constant: few sessions do not tell them all."""


class Course(Protocol):
    """What is fitted of a session: see `experiments.forecast.Row`."""

    features: list[list[float]]
    spent: list[float]
    seconds: float

    @property
    def converged(self) -> bool: ...


def fit_coefficients(courses: Sequence[Course]) -> str:
    """The coefficients as lines of Python. A session's states count together as one observation."""
    kept = [course for course in courses if course.features]
    x = np.concatenate([np.array(course.features) for course in kept])
    weights = np.concatenate([np.full(len(course.features), 1.0 / len(course.features)) for course in kept])
    converged = np.concatenate([np.full(len(course.features), float(course.converged)) for course in kept])
    scans = np.concatenate([np.arange(len(course.features), 0, -1, dtype=np.float64) for course in kept])
    seconds = np.concatenate([course.seconds - np.array(course.spent) for course in kept])
    fits = {
        "CHANCE": _fit(x, lambda z: np.logaddexp(0.0, z) - converged * z, weights),
        "SCANS": _fit(x, lambda z: np.exp(z) - scans * z, weights),
        "SECONDS": _fit(x, lambda z: (np.exp(z) - seconds * z) / seconds.mean(), weights),
    }
    lines = [f"# {len(kept)} sessions, {len(x)} states"]
    for name, values in fits.items():
        lines.append(f"{name}: Final = Features({', '.join(f'{value:.2f}' for value in values)})")
    return "\n".join(lines)


def _fit(x: Array, loss: Callable[[Array], Array], weights: Array) -> Array:
    """The coefficients (9,) that minimise the weighted sum of `loss` of the linear predictors, and the ridge."""
    scale = np.array([0.0, *[_RIDGE] * (len(Features._fields) - 1)])

    def objective(coefficients: Array) -> float:
        return float(weights @ loss(np.clip(x @ coefficients, -10, 10)) + 0.5 * scale @ coefficients**2)

    return np.asarray(minimize(objective, np.zeros(len(scale)), method="BFGS").x, dtype=np.float64)
