"""What a scan would cost, as a share of what is left of the session's budget."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from pretouch.exhaustion import Exhaustion
from pretouch.trajectory import Trajectory
from pretouch_orchestrator.planning.coverage import CoveragePredictor
from pretouch_orchestrator.sessions.record import Record

_COVERAGE_MARGIN = 0.2
"""Share by which a scan may cover more of the object than predicted."""
_CORRECTION_MARGIN = 0.01
"""Share of the object by which the coverage of earlier scans may change with the next correction."""
_PATH_SHARES = (1.0, 0.5, 0.25)
"""Shares of a region's path that are tried, in this order, until the budget allows one."""


class AffordablePath(NamedTuple):
    """A path that the budget allows, over a region or over the beginning of its perimeter.

    Attributes:
        share: what it would use of what is left of its scarcest budget, at most 1.
    """

    region_id: str
    path: Trajectory
    share: float


class _Cost(NamedTuple):
    """The share that a scan would use of what is left of its scarcest budget; above 1 it is not affordable."""

    share: float
    scarcest: Exhaustion


class _CostPredictor:
    """Predicts the cost of scans along `paths`, all with the same orientation of the tip.

    The predicted coverage is given a margin, except for the first scan: on a small object that one alone covers much,
    and without it nothing would be known.
    """

    def __init__(self, record: Record, paths: Mapping[str, Trajectory]) -> None:
        self._record = record
        base_R_tip = next(iter(paths.values())).base_T_tip[0, :3, :3]
        self._coverage = CoveragePredictor(record.corrected_cloud(), record.measured, record.request.sensor, base_R_tip)

    def predict(self, path: Trajectory) -> _Cost:
        budget, used = self._record.request.budget, self._record.budget_used
        fraction = self._coverage.predict_fraction(path)
        if self._record.scans:
            fraction += _COVERAGE_MARGIN * max(fraction - used.fraction, 0.0) + _CORRECTION_MARGIN
        shares = {
            Exhaustion.SCANS: 1 / max(budget.scans - used.scans, 1e-9),
            Exhaustion.SECONDS: path.duration / max(budget.seconds - used.seconds, 1e-9),
            Exhaustion.FRACTION: max(fraction - used.fraction, 0.0) / max(budget.fraction - used.fraction, 1e-9),
        }
        scarcest = max(shares, key=shares.__getitem__)
        return _Cost(shares[scarcest], scarcest)


def select_affordable(record: Record, paths: Mapping[str, Trajectory]) -> list[AffordablePath]:
    """Those of `paths`, by region id, that the budget allows, shortened where it does not allow all of the path."""
    if not paths:
        return []
    costs = _CostPredictor(record, paths)
    affordable = []
    for region_id, path in paths.items():
        for share in _PATH_SHARES:
            shortened = path.beginning(share)
            if (cost := costs.predict(shortened)).share <= 1:
                affordable.append(AffordablePath(region_id, shortened, cost.share))
                break
    return affordable


def find_limit(record: Record, paths: Mapping[str, Trajectory]) -> Exhaustion:
    """Why no further scan is planned, given that none of `paths` is affordable: a budget, or that there is no path.

    Where different paths exceed different budgets, it is the budget that the cheapest path exceeds.
    """
    budget, used = record.request.budget, record.budget_used
    if used.scans >= budget.scans:
        return Exhaustion.SCANS
    if paths:
        costs = _CostPredictor(record, paths)
        predicted = [costs.predict(path.beginning(_PATH_SHARES[-1])) for path in paths.values()]
        return min(predicted, key=lambda cost: cost.share).scarcest
    if used.seconds >= budget.seconds:
        return Exhaustion.SECONDS
    return Exhaustion.FRACTION if used.fraction >= budget.fraction else Exhaustion.NOTHING_TO_GAIN
