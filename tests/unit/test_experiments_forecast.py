"""A session cut at another tolerance or budget ends where it would have, and the fit finds what made it so."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from pretouch_orchestrator.sessions.forecast import Features

from experiments.forecast_fit import Course, cut, fit_coefficients
from experiments.forecast_report import binomial_interval, collect_states, write_report
from pretouch.session import Forecast


@dataclass
class Made:
    """A session of three scans of 4 s whose quantile halves with each; it ended with 2 mm."""

    tolerance: float = 0.002
    features: list[list[float]] = field(
        default_factory=lambda: [list(Features(1, k, 0.5, 2, 3, 1, 0, k)) for k in (2, 1, 0)]
    )
    spent: list[float] = field(default_factory=lambda: [0.0, 4.0, 8.0])
    durations: list[float] = field(default_factory=lambda: [4.0] * 3)
    quantiles: list[float] = field(default_factory=lambda: [0.016, 0.008, 0.004, 0.002])
    explained: list[bool] = field(default_factory=lambda: [True] * 4)
    seconds: float = 12.0
    converged: bool = True

    @property
    def forecasts(self) -> list[Forecast]:
        return [Forecast(3.0 - k, 12.0 - 4 * k, 0.5 + 0.1 * k) for k in range(len(self.features))]


@pytest.mark.parametrize(
    ("tolerance", "scans", "seconds", "made", "converged"),
    [
        (0.002, 10, 120.0, 3, True),
        (0.005, 10, 120.0, 2, True),
        (0.005, 2, 120.0, 2, True),
        (0.002, 2, 120.0, 2, False),
        (0.002, 10, 9.0, 2, False),
        (0.02, 10, 120.0, 0, True),
        (0.001, 10, 120.0, 3, False),
    ],
)
def test_a_session_is_cut_where_it_would_have_ended(
    tolerance: float, scans: int, seconds: float, made: int, converged: bool
) -> None:
    found = cut(Made(), tolerance, scans, seconds)
    assert found.converged is converged
    np.testing.assert_array_equal(found.scans, np.arange(made, 0, -1))
    np.testing.assert_allclose(found.seconds, 4.0 * np.arange(made, 0, -1))
    if made:
        first = Features(*found.features[0])
        assert first.need == pytest.approx(np.log(0.016 / tolerance))
        assert first.scans == pytest.approx(np.log(scans))
        assert first.seconds == pytest.approx(np.log(min(seconds / 4.0, 30.0)))


def test_an_estimate_that_does_not_explain_its_samples_has_not_converged() -> None:
    found = cut(Made(explained=[True, True, False, True]), 0.005, 10, 120.0)
    assert (len(found.features), found.converged) == (3, True)
    assert not cut(Made(explained=[True, True, True, False]), 0.002, 10, 120.0).converged


def test_what_lies_beyond_the_tolerance_lowers_the_fitted_chance() -> None:
    rng = np.random.default_rng(0)
    courses: list[Course] = []
    for _ in range(60):
        start = rng.uniform(0.004, 0.06)
        courses.append(Made(quantiles=(start * 0.5 ** np.arange(4)).tolist()))
    lines = fit_coefficients(courses).splitlines()
    assert [line.partition(":")[0] for line in lines[1:]] == ["CHANCE", "SCANS", "SECONDS"]
    chance, scans, _ = (
        [float(value) for value in line.partition("Features(")[2].rstrip(")").split(", ")] for line in lines[1:]
    )
    assert len(chance) == len(Features._fields)
    assert chance[1] < -0.5 < 0.0 < scans[1]


def test_states_and_intervals_of_the_report(tmp_path: Path) -> None:
    courses = [Made(), Made(converged=False), Made()]
    states = collect_states(courses, 1)
    np.testing.assert_allclose(states.stated, [[2.0, 8.0, 0.6]] * 3)
    np.testing.assert_allclose(states.scans, 2.0)
    np.testing.assert_allclose(states.seconds, 8.0)
    low, high = binomial_interval(2, 3)
    assert low < 2 / 3 < high
    assert binomial_interval(0, 10)[0] == 0.0
    assert binomial_interval(10, 10)[1] == 1.0
    write_report({"random random": courses}, "python -m experiments.forecast", tmp_path)
    assert "3 in `random random`" in (tmp_path / "forecast.md").read_text()
    assert (tmp_path / "forecast.png").stat().st_size > 10_000
