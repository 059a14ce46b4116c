"""Which scans the rest of a session's budget allows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pretouch.exhaustion import Exhaustion
from pretouch.geometry import Array
from pretouch_orchestrator.planning.candidates import CandidatePath
from pretouch_orchestrator.planning.coverage import CoveragePredictor
from pretouch_orchestrator.sessions.record import Record

_COVERAGE_MARGIN = 0.2
"""Share by which a scan may cover more of the object than predicted."""
_CORRECTION_MARGIN = 0.01
"""Share of the object by which the coverage of earlier scans may change with the next correction."""


def select_affordable(record: Record, candidates: Sequence[CandidatePath]) -> list[CandidatePath]:
    """The candidates with those of their spans that the budget allows, and whose samples are not too many for a scan.

    Those without any are left out.
    """
    affordable, longest = [], record.request.sensor.longest_scan
    for candidate, costs in zip(candidates, _predict_costs(record, candidates), strict=True):
        short = np.array([end - start <= longest for start, end in candidate.spans])
        allowed = np.flatnonzero((costs.max(axis=1) <= 1) & short)
        if len(allowed):
            affordable.append(candidate.with_spans([candidate.spans[k] for k in allowed]))
    return affordable


def find_limit(record: Record, candidates: Sequence[CandidatePath]) -> Exhaustion:
    """Why no further scan is planned, given that none of the candidates is affordable: a budget, or that there is none.

    Where different scans exceed different budgets, it is the budget that the cheapest scan exceeds.
    """
    budget, used = record.request.budget, record.budget_used
    if used.scans >= budget.scans:
        return Exhaustion.SCANS
    if candidates:
        costs = np.concatenate(_predict_costs(record, candidates))
        cheapest = costs[costs.max(axis=1).argmin()]
        return (Exhaustion.SECONDS, Exhaustion.FRACTION)[int(cheapest.argmax())]
    if used.seconds >= budget.seconds:
        return Exhaustion.SECONDS
    return Exhaustion.FRACTION if used.fraction >= budget.fraction else Exhaustion.NOTHING_TO_GAIN


def _predict_costs(record: Record, candidates: Sequence[CandidatePath]) -> list[Array]:
    """For each candidate (k, 2): the shares that each of its spans would use of the seconds and the fraction left.

    The predicted coverage is given a margin, except for the first scan: on a small object that one alone covers much,
    and without it nothing would be known.
    """
    if not candidates:
        return []
    budget, used = record.request.budget, record.budget_used
    base_R_tip = candidates[0].path.base_T_tip[0, :3, :3]
    coverage = CoveragePredictor(record.corrected_cloud(), record.measured, record.request.sensor, base_R_tip)
    costs = []
    for candidate in candidates:
        fraction = coverage.predict_fractions(candidate.path, candidate.spans)
        if record.scans:
            fraction += _COVERAGE_MARGIN * np.maximum(fraction - used.fraction, 0.0) + _CORRECTION_MARGIN
        seconds = np.array([end - start for start, end in candidate.spans])
        costs.append(
            np.column_stack(
                [
                    seconds / max(budget.seconds - used.seconds, 1e-9),
                    np.maximum(fraction - used.fraction, 0.0) / max(budget.fraction - used.fraction, 1e-9),
                ]
            )
        )
    return costs
