"""What a scan would cost of what is left of a session's budget."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pretouch.exhaustion import Exhaustion
from pretouch.trajectory import Trajectory
from pretouch_orchestrator.planning.coverage import Foresight
from pretouch_orchestrator.sessions.record import Record

_MISJUDGED = 0.2
"""Share of a foreseen scan by which the real one may touch more of the object."""
_PARTS = (1.0, 0.5, 0.25)
"""How much of a region's path is scanned where the budget does not last for all of it."""
_MOVED = 0.01
"""Share of the object by which what earlier scans touched may change with the next correction."""


@dataclass(frozen=True)
class _Cost:
    """The share that a scan would use of what is left of its scarcest budget; above 1 there is not enough left."""

    share: float
    scarcest: Exhaustion


class _Outlook:
    """What scans along `paths`, which share the tip's orientation, would cost.

    Foreseen scans get an allowance for what they may touch unforeseen, but not the first one: of a small object it
    touches much, and without it nothing would be known.
    """

    def __init__(self, record: Record, paths: Mapping[str, Trajectory]) -> None:
        self._record = record
        base_R_tip = next(iter(paths.values())).base_T_tip[0, :3, :3]
        self._foresight = Foresight(record.corrected_cloud(), record.measured, record.request.sensor, base_R_tip)

    def cost(self, path: Trajectory) -> _Cost:
        budget, spent = self._record.request.budget, self._record.budget_used
        after = self._foresight.fraction_after(path)
        if self._record.scans:
            after += _MISJUDGED * max(after - spent.fraction, 0.0) + _MOVED
        shares = {
            Exhaustion.SCANS: 1 / max(budget.scans - spent.scans, 1e-9),
            Exhaustion.SECONDS: path.duration / max(budget.seconds - spent.seconds, 1e-9),
            Exhaustion.FRACTION: max(after - spent.fraction, 0.0) / max(budget.fraction - spent.fraction, 1e-9),
        }
        scarcest = max(shares, key=shares.__getitem__)
        return _Cost(shares[scarcest], scarcest)


def affordable(record: Record, paths: Mapping[str, Trajectory]) -> list[tuple[str, Trajectory, float]]:
    """Each of `paths`, by region id, as far along as the budget lets, with its share of the budget that is left.

    The share is that of the scarcest budget.
    """
    if not paths:
        return []
    outlook = _Outlook(record, paths)
    fitting = []
    for region_id, path in paths.items():
        for part in _PARTS:
            shortened = path.beginning(part)
            if (cost := outlook.cost(shortened)).share <= 1:
                fitting.append((region_id, shortened, cost.share))
                break
    return fitting


def limit_of(record: Record, paths: Mapping[str, Trajectory]) -> Exhaustion:
    """What keeps the session from another scan, none of `paths` being affordable: a budget, or that there is no path.

    Where different budgets forbid different paths it is the one that the cheapest path exceeds.
    """
    budget, spent = record.request.budget, record.budget_used
    if spent.scans >= budget.scans:
        return Exhaustion.SCANS
    if paths:
        outlook = _Outlook(record, paths)
        costs = [outlook.cost(path.beginning(_PARTS[-1])) for path in paths.values()]
        return min(costs, key=lambda cost: cost.share).scarcest
    if spent.seconds >= budget.seconds:
        return Exhaustion.SECONDS
    return Exhaustion.FRACTION if spent.fraction >= budget.fraction else Exhaustion.NOTHING_TO_GAIN
