"""A session as the experiments with forecasts keep it."""

from __future__ import annotations

from dataclasses import dataclass

from pretouch_orchestrator.sessions import forecast

from pretouch.session import Forecast, State


@dataclass(frozen=True)
class Course:
    """What became of a session, from each of its states that awaited a scan.

    Attributes:
        world: of the simulation: camera and finger.
        mesh, view: which one; the view is its number in the experiment.
        tolerance: m.
        features: (s, 8) of each state.
        rest: (s, 2) scans and robot seconds that the budget has left in each state.
        spent: (s,) robot seconds spent before each state.
        durations: (s,) s, of the scan that each state awaited.
        quantiles: (s + 1,) m, of the error at the tolerance's confidence, in each state and at the end.
        explained: (s + 1,) whether the estimate explained the samples.
        seconds: robot seconds of the whole session.
        state, reason: how it ended.
        error: m, the true error at the end, at the points where it counts.
    """

    world: str
    mesh: str
    view: int
    tolerance: float
    features: list[list[float]]
    rest: list[tuple[int, float]]
    spent: list[float]
    durations: list[float]
    quantiles: list[float]
    explained: list[bool]
    seconds: float
    state: str
    reason: str
    error: float

    @property
    def forecasts(self) -> list[Forecast]:
        """By the coefficients that there are now."""
        return [
            forecast.compute_forecast(forecast.Features(*features), *rest)
            for features, rest in zip(self.features, self.rest, strict=True)
        ]

    @property
    def converged(self) -> bool:
        return self.state == State.CONVERGED.value
